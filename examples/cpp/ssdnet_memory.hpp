// Earlier returns, moved by poses into the present frame, where the present scan allows them.
//
// It is runtime/streams/memory.py step by step, for rectified images; docs/streams.md says what it does. It needs the
// standard library alone. Call clear() where the poses jump, or another sensor or size begins.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <iterator>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace ssdnet {

struct Camera {
  int height, width;
  double fx, fy, cx, cy;  // integers are pixel centres
};

class ScanMemory {
 public:
  using Pose = std::array<double, 16>;  // 4 x 4, row after row, rigid

  explicit ScanMemory(double seconds = 2.0) : longest_ns_(std::llround(seconds * 1e9)) {}

  double rejected_share = -1;  // of the earlier returns that the present ones contradict; -1: there are none
  std::string off;             // why nothing is added although there are earlier returns; empty: nothing is wrong

  // Return the earlier returns for a frame (metres, 0 = none and where the frame has its own), and remember its own.
  // `pose` is the camera's at the time of the image, to a frame that is fixed over seconds.
  const std::vector<float>& recall(const float* sparse_depth, const Camera& camera, const Pose& pose, std::int64_t stamp_ns) {
    if (last_ns_ && (stamp_ns <= *last_ns_ || stamp_ns - *last_ns_ > longest_ns_)) clear();
    last_ns_ = stamp_ns;
    const auto pixels = static_cast<std::size_t>(camera.height) * static_cast<std::size_t>(camera.width);
    present_.resize(pixels);
    returns_.assign(pixels, 0.0f);
    rejected_share = -1;
    for (std::size_t i = 0; i < pixels; ++i) {
      const float depth = sparse_depth[i];
      present_[i] = depth > 0 && depth < std::numeric_limits<float>::max() ? depth : 0;
    }
    while (!scans_.empty() && stamp_ns - scans_.front().stamp_ns > longest_ns_) scans_.pop_front();
    std::vector<const Scan*> used;
    for (const Scan& scan : scans_)
      if (way(scan.pose, pose) >= kLeastWay) used.push_back(&scan);
    const bool is_far = used.size() == scans_.size();
    if (!used.empty() && !(!off.empty() && stamp_ns < off_until_ns_)) remember(used, camera, pose, stamp_ns);
    last_ = unproject(camera, pose, stamp_ns);
    traffic_.points.clear();
    if (is_far) {
      scans_.push_back(last_);
      if (scans_.size() > kScans) scans_.pop_front();
    }
    return returns_;
  }

  // Forget returns of the last frame where its answer shows what may move (0 = stands still), and add none there.
  void answered(const std::vector<std::uint8_t>& may_move) {
    const auto moves = [&](const Point& each) { return may_move[each.pixel] != 0; };
    traffic_ = {{}, last_.pose, last_.stamp_ns};
    std::copy_if(last_.points.begin(), last_.points.end(), std::back_inserter(traffic_.points), moves);
    if (scans_.empty() || scans_.back().stamp_ns != last_.stamp_ns) return;
    auto& points = scans_.back().points;
    points.erase(std::remove_if(points.begin(), points.end(), moves), points.end());
  }

  void clear() {
    scans_.clear();
    last_ns_.reset();
    off.clear();
    apart_.clear();
    rejected_.clear();
    last_.points.clear();
    traffic_.points.clear();
  }

 private:
  struct Point {
    float x, y, z;  // metres, in the frame of its camera
    std::size_t pixel;
  };
  struct Scan {
    std::vector<Point> points;
    Pose pose;
    std::int64_t stamp_ns;
  };
  struct Seen {
    std::size_t pixel;
    float depth;
  };
  static constexpr double kLeastWay = 0.3, kMostGaps = 4.0, kMostApart = 0.01, kMostRejected = 0.5;
  static constexpr std::size_t kScans = 10, kPoints = 10000, kLeastBeside = 20, kLeastFrames = 3, kFrames = 5;
  static constexpr float kTolerance = 1.03f, kHiddenShare = 0.9f, kEdgeShare = 0.5f, kTrafficColumns = 1 / 45.0f;
  static constexpr std::array<double, 3> kNearer{0, 0.75, 1.5};
  static constexpr int kCell = 4, kLineRows = 1, kEdge = 2;
  static constexpr std::int64_t kPause = 5000000000;

  static double way(const Pose& a, const Pose& b) { return std::hypot(a[3] - b[3], a[7] - b[7], a[11] - b[11]); }

  // The figures of the last frames, and their median; 0 of too few.
  static void append(std::deque<float>& figures, double value) {
    figures.push_back(static_cast<float>(value));
    if (figures.size() > kFrames) figures.pop_front();
  }
  static double middle(const std::deque<float>& figures) {
    return figures.size() < kLeastFrames ? 0.0 : median(std::vector<float>(figures.begin(), figures.end()));
  }

  static double median(std::vector<float> values) {
    const std::size_t half = values.size() / 2;
    std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(half), values.end());
    const double upper = values[half];
    if (values.size() % 2) return upper;
    return (upper + *std::max_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(half))) / 2;
  }

  Scan unproject(const Camera& camera, const Pose& pose, std::int64_t stamp_ns) const {
    std::vector<std::size_t> measured;
    for (std::size_t i = 0; i < present_.size(); ++i)
      if (present_[i] > 0) measured.push_back(i);
    const std::size_t step = std::max<std::size_t>(1, (measured.size() + kPoints - 1) / kPoints);
    Scan scan{{}, pose, stamp_ns};
    for (std::size_t i = 0; i < measured.size(); i += step) {
      const auto row = static_cast<double>(measured[i] / static_cast<std::size_t>(camera.width));
      const auto column = static_cast<double>(measured[i] % static_cast<std::size_t>(camera.width));
      const float depth = present_[measured[i]];
      scan.points.push_back({static_cast<float>((column - camera.cx) / camera.fx * depth),
                             static_cast<float>((row - camera.cy) / camera.fy * depth), depth, measured[i]});
    }
    return scan;
  }

  // The points of a scan that fall into the image if they have come nearer by so many metres.
  static void project(const Scan& scan, const Camera& camera, const Pose& to, std::vector<Seen>& seen, double nearer = 0) {
    double move[12];  // from the scan's camera to the present one, the positions subtracted first
    for (int row = 0; row < 3; ++row)
      for (int column = 0; column < 4; ++column) {
        double sum = 0;
        for (int i = 0; i < 3; ++i)
          sum += to[4 * i + row] * (column < 3 ? scan.pose[4 * i + column] : scan.pose[4 * i + 3] - to[4 * i + 3]);
        move[4 * row + column] = sum;
      }
    move[11] -= nearer;
    float matrix[12];
    for (int column = 0; column < 4; ++column) {
      matrix[column] = static_cast<float>(camera.fx * move[column] + camera.cx * move[8 + column]);
      matrix[4 + column] = static_cast<float>(camera.fy * move[4 + column] + camera.cy * move[8 + column]);
      matrix[8 + column] = static_cast<float>(move[8 + column]);
    }
    for (const Point& p : scan.points) {
      const auto at = [&](int row) { return matrix[row] * p.x + matrix[row + 1] * p.y + matrix[row + 2] * p.z + matrix[row + 3]; };
      const float depth = at(8);
      if (!(depth > 0)) continue;
      const float u = std::nearbyint(at(0) / depth), v = std::nearbyint(at(4) / depth);
      if (u >= 0 && v >= 0 && u < static_cast<float>(camera.width) && v < static_cast<float>(camera.height))
        seen.push_back({static_cast<std::size_t>(v) * static_cast<std::size_t>(camera.width) + static_cast<std::size_t>(u), depth});
    }
  }

  void remember(const std::vector<const Scan*>& used, const Camera& camera, const Pose& pose, std::int64_t stamp_ns) {
    std::vector<Seen> seen, allowed;
    for (const Scan* scan : used) project(*scan, camera, pose, seen);
    find_lines(camera);
    find_traffic(camera, pose);
    std::vector<float> apart;
    std::size_t bounded = 0;
    for (const Seen& each : seen) {
      if (const float own = present_[each.pixel]; own > 0)
        apart.push_back(std::abs(std::log(each.depth / own)));
      else if (const int fits = is_traffic_[each.pixel] ? -1 : bounds(each, camera); fits >= 0) {
        ++bounded;
        if (fits) allowed.push_back(each);
      }
    }
    if (bounded) rejected_share = 1 - static_cast<double>(allowed.size()) / static_cast<double>(bounded);
    if (!judge(apart, stamp_ns)) return;
    std::vector<float> nearest(present_.size());
    for (std::size_t i = 0; i < nearest.size(); ++i) nearest[i] = present_[i] > 0 ? present_[i] : INFINITY;
    for (const Seen& each : allowed) nearest[each.pixel] = std::min(nearest[each.pixel], each.depth);
    const int rows = std::min(std::max(static_cast<int>(std::nearbyint(gap_ / 2)), 2), 8);
    for (const Seen& each : allowed) {  // not at an edge
      const float depth = nearest[each.pixel];
      bool is_edge = false;
      around(each.pixel, rows, kEdge, camera, [&](std::size_t at) {
        is_edge |= nearest[at] < kHiddenShare * depth || (nearest[at] < INFINITY && depth < kEdgeShare * nearest[at]);
      });
      if (!is_edge) returns_[each.pixel] = depth;
    }
  }

  // Call a function with each pixel of a window with so many rows and columns on each side of its middle.
  template <typename Function>
  static void around(std::size_t pixel, int rows, int columns, const Camera& camera, Function function) {
    const auto width = static_cast<std::size_t>(camera.width);
    const int row = static_cast<int>(pixel / width), column = static_cast<int>(pixel % width);
    for (int r = std::max(0, row - rows); r <= std::min(camera.height - 1, row + rows); ++r)
      for (int c = std::max(0, column - columns); c <= std::min(camera.width - 1, column + columns); ++c)
        function(static_cast<std::size_t>(r) * width + static_cast<std::size_t>(c));
  }

  // The pixels where traffic of the last frame is or may have come since.
  void find_traffic(const Camera& camera, const Pose& pose) {
    is_traffic_.assign(present_.size(), false);
    std::vector<Seen> seen;
    for (const double nearer : kNearer) project(traffic_, camera, pose, seen, nearer);
    const int rows = static_cast<int>(std::nearbyint(gap_)), columns = static_cast<int>(std::nearbyint(kTrafficColumns * camera.fx));
    for (const Seen& each : seen)
      around(each.pixel, rows, columns, camera, [&](std::size_t at) { is_traffic_[at] = true; });
  }

  // Whether the figures allow the memory to be used, see `_Guard` in Python.
  bool judge(const std::vector<float>& apart, std::int64_t stamp_ns) {
    if (!off.empty()) {  // tried again, from the figures from here on
      apart_.clear();
      rejected_.clear();
    }
    off.clear();
    if (apart.size() >= kLeastBeside) append(apart_, median(apart));
    if (rejected_share >= 0) append(rejected_, rejected_share);
    if (middle(apart_) > kMostApart) off = "earlier returns are off the present ones";
    else if (middle(rejected_) > kMostRejected) off = "the present scan contradicts the earlier returns";
    off_until_ns_ = stamp_ns + kPause;
    return off.empty();
  }

  // The scan lines at each row and cell of columns.
  void find_lines(const Camera& camera) {
    const int height = camera.height;
    cells_ = (camera.width + kCell - 1) / kCell;
    const auto index = [this](int row, int cell) { return static_cast<std::size_t>(row) * static_cast<std::size_t>(cells_) + static_cast<std::size_t>(cell); };
    const std::size_t count = index(height, 0);
    std::vector<float> low(count, INFINITY), high(count, 0.0f);
    for (int row = 0; row < height; ++row)
      for (int column = 0; column < camera.width; ++column)
        if (const float depth = present_[static_cast<std::size_t>(row) * static_cast<std::size_t>(camera.width) + static_cast<std::size_t>(column)]; depth > 0) {
          const std::size_t at = index(row, column / kCell);
          low[at] = std::min(low[at], depth);
          high[at] = std::max(high[at], depth);
        }
    nearest_.assign(count, INFINITY);
    farthest_.assign(count, 0.0f);
    for (int row = 0; row < height; ++row)
      for (int cell = 0; cell < cells_; ++cell)
        for (int r = std::max(0, row - kLineRows); r <= std::min(height - 1, row + kLineRows); ++r)
          for (int c = std::max(0, cell - 1); c <= std::min(cells_ - 1, cell + 1); ++c) {
            nearest_[index(row, cell)] = std::min(nearest_[index(row, cell)], low[index(r, c)]);
            farthest_[index(row, cell)] = std::max(farthest_[index(row, cell)], high[index(r, c)]);
          }
    above_.assign(count, -1);
    below_.assign(count, height);
    std::vector<float> gaps;
    for (int cell = 0; cell < cells_; ++cell) {
      int line = -1, next = -1;  // the last line, and what a row has above its own line
      for (int row = 0; row < height; ++row) {
        if (farthest_[index(row, cell)] > 0) line = row;
        else next = line;
        above_[index(row, cell)] = next;
      }
      line = next = height;
      for (int row = height - 1; row >= 0; --row) {
        if (farthest_[index(row, cell)] > 0) line = row;
        else next = line;
        below_[index(row, cell)] = next;
        if (!(farthest_[index(row, cell)] > 0) && above_[index(row, cell)] >= 0 && next < height)
          gaps.push_back(static_cast<float>(next - above_[index(row, cell)]));
      }
    }
    gap_ = gaps.empty() ? 1.0 : median(std::move(gaps));
  }

  // -1: nothing bounds the depth; 1: it lies between the returns around it; 0: they contradict it.
  int bounds(const Seen& seen, const Camera& camera) const {
    const auto width = static_cast<std::size_t>(camera.width), cells = static_cast<std::size_t>(cells_);
    const std::size_t cell = seen.pixel % width / kCell;
    const int row = static_cast<int>(seen.pixel / width);
    const std::size_t at = static_cast<std::size_t>(row) * cells + cell;
    const int above = above_[at], below = below_[at];
    const bool has_above = above >= 0 && row - above <= kMostGaps * gap_, has_below = below < camera.height && below - row <= kMostGaps * gap_;
    const bool is_on_line = farthest_[at] > 0;
    if (!is_on_line && !(has_above && has_below)) return -1;
    float least = nearest_[at], greatest = farthest_[at];
    for (const auto& [there, line] : {std::pair{has_above, above}, std::pair{has_below, below}})
      if (there) {
        least = std::min(least, nearest_[static_cast<std::size_t>(line) * cells + cell]);
        greatest = std::max(greatest, farthest_[static_cast<std::size_t>(line) * cells + cell]);
      }
    return seen.depth * kTolerance > least && seen.depth < greatest * kTolerance;
  }

  std::int64_t longest_ns_, off_until_ns_ = 0;
  std::deque<Scan> scans_;
  std::optional<std::int64_t> last_ns_;
  double gap_ = 1;
  std::deque<float> apart_, rejected_;
  Scan last_{}, traffic_{};  // the returns of the last frame, and those where its answer shows what may move
  std::vector<bool> is_traffic_;
  std::vector<float> present_, returns_, nearest_, farthest_;
  std::vector<int> above_, below_;
  int cells_ = 0;
};

}  // namespace ssdnet
