// The part of ssdnet.hpp that resizes frames and answers, by the rules that docs/model_file.md names.
//
// Sums and products are in the order of the engine's OpenCV (its wheel for x86-64), so that answers equal the engine's.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <vector>

namespace ssdnet {

struct Size {
  int height = 0, width = 0;
  std::size_t pixels() const { return static_cast<std::size_t>(height) * static_cast<std::size_t>(width); }
  bool operator==(const Size& other) const { return height == other.height && width == other.width; }
  bool operator!=(const Size& other) const { return !(*this == other); }
};

namespace resizing {

// rint((u + 0.5) * after / before - 0.5) of each pixel u of a side, half to even, in integers.
inline std::vector<int> moved_pixels(int before, int after) {
  std::vector<int> moved(static_cast<std::size_t>(before));
  for (int u = 0; u < before; ++u) {
    const std::int64_t numerator = (2 * std::int64_t{u} + 1) * after - before, whole = 2 * std::int64_t{before};
    std::int64_t pixel = numerator >= 0 ? numerator / whole : -((-numerator + whole - 1) / whole);
    const std::int64_t rest = numerator - pixel * whole;
    if (rest > before || (rest == before && pixel % 2 != 0)) ++pixel;
    moved[static_cast<std::size_t>(u)] = static_cast<int>(pixel);
  }
  return moved;
}

// Each return moves to its pixel, where the nearest stays; 0 = no return.
inline void move_returns(const float* from, Size size, float* to, Size new_size) {
  std::fill(to, to + new_size.pixels(), 0.0f);
  const std::vector<int> rows = moved_pixels(size.height, new_size.height);
  const std::vector<int> columns = moved_pixels(size.width, new_size.width);
  for (const int row : rows)
    for (const int column : columns) {
      const float depth = *from++;
      float& kept = to[static_cast<std::size_t>(row) * static_cast<std::size_t>(new_size.width) +
                       static_cast<std::size_t>(column)];
      if (depth > 0 && !(kept > 0 && kept <= depth)) kept = depth;
    }
}

// The nearest centre of each pixel of a side. At ties the rounding of this sum decides, as in the engine's OpenCV.
inline std::vector<std::size_t> nearest_pixels(int before, int after) {
  std::vector<std::size_t> nearest;
  const double step = static_cast<double>(before) / after;
  double place = 0.5 * before / after;
  for (int u = 0; u < after; ++u, place += step)
    nearest.push_back(static_cast<std::size_t>(std::min(static_cast<int>(place), before - 1)));
  return nearest;
}

template <typename T>
void nearest(const T* from, Size size, T* to, Size new_size) {
  const std::vector<std::size_t> columns = nearest_pixels(size.width, new_size.width);
  for (const std::size_t row : nearest_pixels(size.height, new_size.height))
    for (const std::size_t column : columns) *to++ = from[row * static_cast<std::size_t>(size.width) + column];
}

template <typename T>
T rounded(float value) {
  if constexpr (std::is_same_v<T, float>) return value;
  return static_cast<T>(std::min(255.0f, std::max(0.0f, std::nearbyint(value))));
}

// A share of a pixel of a side before in a pixel after.
struct Share {
  std::size_t from, to;
  float weight;
};

inline std::vector<Share> area_shares(int before, int after) {
  std::vector<Share> shares;
  const double scale = 1 / (static_cast<double>(after) / before);
  const auto add = [&](int from, int to, double weight) {
    shares.push_back({static_cast<std::size_t>(from), static_cast<std::size_t>(to), static_cast<float>(weight)});
  };
  for (int u = 0; u < after; ++u) {
    const double start = u * scale, end = start + scale, width = std::min(scale, before - start);
    const int last = std::min(static_cast<int>(std::floor(end)), before - 1);
    const int first = std::min(static_cast<int>(std::ceil(start)), last);
    if (first - start > 1e-3) add(first - 1, u, (first - start) / width);
    for (int each = first; each < last; ++each) add(each, u, 1 / width);
    if (end - last > 1e-3) add(last, u, std::min(std::min(end - last, 1.0), width) / width);
  }
  return shares;
}

// Means of the area, where no side grows.
template <typename T>
void area(const T* from, Size size, T* to, Size new_size, int channels) {
  const auto depth = static_cast<std::size_t>(channels);
  const std::size_t in_row = static_cast<std::size_t>(size.width) * depth;
  const std::size_t out_row = static_cast<std::size_t>(new_size.width) * depth;
  if (size.height % new_size.height == 0 && size.width % new_size.width == 0) {  // whole pixels: sums
    const auto high = static_cast<std::size_t>(size.height / new_size.height);
    const auto wide = static_cast<std::size_t>(size.width / new_size.width);
    const float share = 1.0f / static_cast<float>(high * wide);
    for (std::size_t row = 0; row < static_cast<std::size_t>(new_size.height); ++row)
      for (std::size_t each = 0; each < out_row; ++each) {
        const T* corner = from + row * high * in_row + each / depth * wide * depth + each % depth;
        float sum = 0;
        for (std::size_t y = 0; y < high; ++y)
          for (std::size_t x = 0; x < wide; ++x) sum += static_cast<float>(corner[y * in_row + x * depth]);
        const bool of_four = !std::is_same_v<T, float> && high == 2 && wide == 2;  // half up, others half to even
        *to++ = of_four ? static_cast<T>((sum + 2) / 4) : rounded<T>(sum * share);
      }
    return;
  }
  const std::vector<Share> columns = area_shares(size.width, new_size.width);
  std::vector<float> line(out_row), sums(out_row, 0.0f);
  std::size_t row = 0;
  const auto write = [&] {
    for (std::size_t each = 0; each < out_row; ++each) to[row * out_row + each] = rounded<T>(sums[each]);
  };
  for (const Share& share : area_shares(size.height, new_size.height)) {
    std::fill(line.begin(), line.end(), 0.0f);
    for (const Share& column : columns)
      for (std::size_t channel = 0; channel < depth; ++channel)
        line[column.to * depth + channel] +=
            static_cast<float>(from[share.from * in_row + column.from * depth + channel]) * column.weight;
    if (share.to != row) {
      write();
      row = share.to;
      std::fill(sums.begin(), sums.end(), 0.0f);
    }
    for (std::size_t each = 0; each < out_row; ++each) sums[each] += share.weight * line[each];
  }
  write();
}

// The two pixels of a side before that a pixel after lies between, and the share of the second.
struct Between {
  std::size_t first, second;
  float weight;
};

template <typename Number>  // of the positions
std::vector<Between> between_pixels(int before, int after) {
  std::vector<Between> places;
  const double scale = 1 / (static_cast<double>(after) / before);
  for (int u = 0; u < after; ++u) {
    const auto place = static_cast<Number>((u + 0.5) * scale - 0.5);
    const int first = static_cast<int>(std::floor(place)), kept = std::min(std::max(first, 0), before - 1);
    const bool inside = first >= 0 && first < before - 1;
    places.push_back({static_cast<std::size_t>(kept), static_cast<std::size_t>(kept + (inside ? 1 : 0)),
                      inside ? static_cast<float>(place - static_cast<Number>(first)) : 0.0f});
  }
  return places;
}

// Bilinear, where a side grows: floats, of one channel.
inline void linear(const float* from, Size size, float* to, Size new_size) {
  const auto mix = [](float a, float b, float weight) { return std::fma(b - a, weight, a); };
  const auto width = static_cast<std::size_t>(new_size.width);
  const std::vector<Between> columns = between_pixels<double>(size.width, new_size.width);
  std::array<std::vector<float>, 2> lines{std::vector<float>(width), std::vector<float>(width)};
  std::array<std::size_t, 2> held{SIZE_MAX, SIZE_MAX};  // the row in each line, widened once
  const auto line = [&](std::size_t row) -> const float* {
    if (held[row % 2] != row) {
      const float* source = from + row * static_cast<std::size_t>(size.width);
      for (std::size_t u = 0; u < width; ++u)
        lines[row % 2][u] = mix(source[columns[u].first], source[columns[u].second], columns[u].weight);
      held[row % 2] = row;
    }
    return lines[row % 2].data();
  };
  for (const Between& row : between_pixels<double>(size.height, new_size.height)) {
    const float *above = line(row.first), *below = line(row.second);
    for (std::size_t u = 0; u < width; ++u) *to++ = mix(above[u], below[u], row.weight);
  }
}

// Bytes, in whole numbers: where both sides grow, up to 0.7 % of the values differ from OpenCV's by 1.
inline void linear(const std::uint8_t* from, Size size, std::uint8_t* to, Size new_size, int channels) {
  const auto units = [](float weight) { return static_cast<int>(std::nearbyint(weight * 2048)); };
  const auto depth = static_cast<std::size_t>(channels);
  const std::vector<Between> columns = between_pixels<float>(size.width, new_size.width);
  for (const Between& row : between_pixels<float>(size.height, new_size.height))
    for (const Between& column : columns)
      for (std::size_t channel = 0; channel < depth; ++channel) {
        const auto across = [&](std::size_t line) {
          const std::uint8_t* source = from + line * static_cast<std::size_t>(size.width) * depth + channel;
          return source[column.first * depth] * units(1 - column.weight) +
                 source[column.second * depth] * units(column.weight);
        };
        const int above = units(1 - row.weight) * (across(row.first) >> 4) >> 16;
        const int below = units(row.weight) * (across(row.second) >> 4) >> 16;
        *to++ = static_cast<std::uint8_t>((above + below + 2) >> 2);
      }
}
inline void linear(const float* from, Size size, float* to, Size new_size, int) { linear(from, size, to, new_size); }

// "bilinear": the area along each side that shrinks, then bilinear along one that grows.
template <typename T>
void image(const T* from, Size size, T* to, Size new_size, int channels, std::vector<T>& scratch) {
  const Size smaller{std::min(size.height, new_size.height), std::min(size.width, new_size.width)};
  if (smaller == new_size) return area(from, size, to, new_size, channels);
  if (smaller == size) return linear(from, size, to, new_size, channels);
  scratch.resize(smaller.pixels() * static_cast<std::size_t>(channels));
  area(from, size, scratch.data(), smaller, channels);
  linear(scratch.data(), smaller, to, new_size, channels);
}

// Whether the 3 x 3 pixels around each differ by at most 15 %.
inline std::vector<std::uint8_t> one_surface(const float* from, Size size) {
  const auto width = static_cast<std::size_t>(size.width);
  std::vector<std::uint8_t> is_surface(size.pixels());
  for (int row = 0; row < size.height; ++row)
    for (int column = 0; column < size.width; ++column) {
      float closest = std::numeric_limits<float>::infinity(), farthest = -closest;
      for (int y = std::max(row - 1, 0); y <= std::min(row + 1, size.height - 1); ++y)
        for (int x = std::max(column - 1, 0); x <= std::min(column + 1, size.width - 1); ++x) {
          const float each = from[static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x)];
          closest = std::min(closest, each), farthest = std::max(farthest, each);
        }
      is_surface[static_cast<std::size_t>(row) * width + static_cast<std::size_t>(column)] =
          closest > 0 && farthest <= 1.15f * closest;
    }
  return is_surface;
}

// "surface": inverse depth bilinear where 3 x 3 pixels differ by at most 15 %, else the nearest centre.
inline void surface(const float* from, Size size, float* to, Size new_size) {
  if (new_size.height < size.height || new_size.width < size.width) return nearest(from, size, to, new_size);
  const auto width = static_cast<std::size_t>(size.width);
  const std::vector<std::uint8_t> is_surface = one_surface(from, size);
  std::vector<float> inverse(size.pixels());
  std::transform(from, from + size.pixels(), inverse.begin(), [](float depth) { return 1 / depth; });
  linear(inverse.data(), size, to, new_size);
  const std::vector<std::size_t> columns = nearest_pixels(size.width, new_size.width);
  for (const std::size_t row : nearest_pixels(size.height, new_size.height))
    for (const std::size_t column : columns) {
      const std::size_t centre = row * width + column;
      *to = is_surface[centre] ? 1 / *to : from[centre];
      ++to;
    }
}

}  // namespace resizing
}  // namespace ssdnet
