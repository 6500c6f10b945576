// The part of ssdnet.hpp that moves depth to the returns of a frame that is larger than the network's size.
//
// It is runtime/engine/anchoring.py step by step; docs/model_file.md says what it does.
#pragma once

#include "ssdnet_resize.hpp"

namespace ssdnet::anchoring {

using Plane = std::vector<float>;

// Share (0..1) and mean log ratio of the returns in the window of a level, for each cell.
struct Window {
  Plane share, ratio;
};

inline Window window(const std::array<Plane, 4>& sums, const Plane& log_depth, Size cells, int level) {
  const int side = 1 << level;
  const Size coarse{cells.height / side, cells.width / side};
  const auto width = static_cast<std::size_t>(coarse.width);
  std::array<Plane, 4> maps;  // count, log ratios, log depths and their squares, summed with the weights 1, 2, 1
  for (std::size_t plane = 0; plane < 4; ++plane) {
    Plane small(coarse.pixels()), lines(coarse.pixels());
    resizing::area(sums[plane].data(), cells, small.data(), coarse, 1);
    const auto tent = [](float before, float at, float after) { return 0.5f * at + 0.25f * (before + after); };
    for (std::size_t i = 0; i < small.size(); ++i)
      lines[i] = tent(i % width > 0 ? small[i - 1] : 0, small[i], i % width + 1 < width ? small[i + 1] : 0);
    for (std::size_t i = 0; i < small.size(); ++i)
      small[i] = tent(i >= width ? lines[i - width] : 0, lines[i], i + width < lines.size() ? lines[i + width] : 0);
    maps[plane] = std::move(small);
  }
  for (std::size_t i = 0; i < maps[0].size(); ++i) {
    const float count = maps[0][i], each = 1 / std::max(count, 1e-6f);
    maps[0][i] = std::min(count * static_cast<float>(7.1 * side * side), 1.0f);  // (16 / 6) ** 2 cells
    for (std::size_t plane = 1; plane < 4; ++plane) maps[plane][i] *= each;
  }
  if (level > 0)
    for (Plane& plane : maps) {
      Plane large(cells.pixels());
      resizing::linear(plane.data(), coarse, large.data(), cells);
      plane = std::move(large);
    }
  for (std::size_t i = 0; i < log_depth.size(); ++i)  // another surface than the cell's own
    if (maps[3][i] + log_depth[i] * (log_depth[i] - 2 * maps[2][i]) > 0.06f * 0.06f) maps[0][i] = 0;
  return {std::move(maps[0]), std::move(maps[1])};
}

// Move depth, and its uncertainty (null = none), to the returns of the frame that agree with it, in place. Metres; no
// depth is moved beyond the range.
inline void move_to_returns(float* depth, float* uncertainty, Size size, const float* returns, Size frame, float range) {
  const auto width = static_cast<std::size_t>(size.width);
  Plane own(depth, depth + size.pixels());
  for (float& each : own) each = std::max(each, 1e-3f);
  const std::vector<std::uint8_t> is_surface = resizing::one_surface(own.data(), size);
  const auto whole = [](int side) { return (side + 7) / 8 * 8; };  // cells of 2, whose grid is halved twice
  const Size padded{whole(size.height), whole(size.width)}, cells{padded.height / 2, padded.width / 2};
  std::vector<double> counts(cells.pixels()), ratios(cells.pixels());
  bool any = false;
  const auto place = [](int pixel, int before, int after) {
    const double at = (pixel + 0.5) * (static_cast<double>(after) / before) - 0.5;
    return std::min(std::max(at, 0.0), after - 1.0);
  };
  for (int row = 0; row < frame.height; ++row) {
    const double down = place(row, frame.height, size.height);
    for (int column = 0; column < frame.width; ++column) {
      const float measured = *returns++;
      if (!(measured > 0)) continue;
      const double right = place(column, frame.width, size.width);
      const auto near_row = static_cast<std::size_t>(std::nearbyint(down));
      const auto near_column = static_cast<std::size_t>(std::nearbyint(right));
      double predicted = own[near_row * width + near_column];
      if (is_surface[near_row * width + near_column]) {  // inverse depth is bilinear on a surface
        const auto top = std::min(static_cast<int>(down), size.height - 2), left = std::min(static_cast<int>(right), size.width - 2);
        const float* corner = own.data() + static_cast<std::size_t>(top) * width + static_cast<std::size_t>(left);
        const double y = down - top, x = right - left;
        const double upper = (1 - x) / corner[0] + x / corner[1];
        const double lower = (1 - x) / corner[width] + x / corner[width + 1];
        predicted = 1 / (upper * (1 - y) + lower * y);
      }
      const double ratio = std::log(measured / predicted);
      if (!(std::abs(ratio) < 0.03)) continue;
      const std::size_t cell = near_row / 2 * static_cast<std::size_t>(cells.width) + near_column / 2;
      counts[cell] += 1, ratios[cell] += ratio, any = true;
    }
  }
  if (!any) return;
  Plane log_depth(cells.pixels());
  std::array<Plane, 4> sums;
  for (Plane& plane : sums) plane.resize(cells.pixels());
  for (std::size_t i = 0; i < log_depth.size(); ++i) {
    const std::size_t row = i / static_cast<std::size_t>(cells.width) * 2 + 1, column = i % static_cast<std::size_t>(cells.width) * 2 + 1;
    log_depth[i] = std::log(own[std::min(row, static_cast<std::size_t>(size.height) - 1) * width + std::min(column, width - 1)]);
    const auto count = static_cast<float>(counts[i]);
    sums[0][i] = count, sums[1][i] = static_cast<float>(ratios[i]);
    sums[2][i] = count * log_depth[i], sums[3][i] = sums[2][i] * log_depth[i];
  }
  Plane moved(cells.pixels(), 0.0f), left(cells.pixels(), 1.0f), confirmed(cells.pixels());
  for (int level = 0; level < 3; ++level) {
    const Window found = window(sums, log_depth, cells, level);
    for (std::size_t i = 0; i < moved.size(); ++i) {
      const float share = found.share[i] * left[i];
      moved[i] += share * found.ratio[i];
      left[i] -= share;
      if (level == 0) confirmed[i] = share;
    }
  }
  Plane by(padded.pixels()), known(padded.pixels());
  resizing::linear(moved.data(), cells, by.data(), padded);
  resizing::linear(confirmed.data(), cells, known.data(), padded);
  for (std::size_t i = 0; i < own.size(); ++i) {
    const std::size_t at = i / width * static_cast<std::size_t>(padded.width) + i % width;
    if (is_surface[i]) depth[i] *= std::exp(by[at]);
    depth[i] = std::min(depth[i], range);
    if (!is_surface[i]) continue;
    if (uncertainty != nullptr) uncertainty[i] *= 1 - 0.4f * known[at];
  }
}

}  // namespace ssdnet::anchoring
