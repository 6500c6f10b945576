// A camera at 10 Hz, a network in a thread of its own, and a deadline: the newest frame wins.
//
//   ./loop ssdnet-lite.onnx
//
// Replace `camera` by yours and `use` by what acts on the answer.
#include <condition_variable>
#include <iostream>
#include <mutex>
#include <optional>
#include <thread>

#include "ssdnet.hpp"

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds period{100}, deadline{300};  // of the camera; from a frame to its answer
constexpr int height = 256, width = 832, frames = 20;

struct Frame {
  Clock::time_point taken;
  std::vector<std::uint8_t> rgb;
  std::vector<float> sparse_depth;
};

// One place for one frame: a newer one replaces a frame that still waits.
class Newest {
 public:
  void put(std::optional<Frame> frame) {  // none: there will be no more
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      replaced_ += frame_.has_value();
      ended_ = !frame.has_value();
      if (frame) frame_ = std::move(frame);
    }
    changed_.notify_one();
  }
  std::optional<Frame> take() {  // waits; none at the end
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return frame_ || ended_; });
    return std::exchange(frame_, std::nullopt);
  }
  int replaced() const { return replaced_; }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<Frame> frame_;
  bool ended_ = false;
  int replaced_ = 0;
};

void camera(Newest& newest) {  // a gray picture, and returns at 20 m
  for (auto next = Clock::now(), end = next + frames * period; next < end; std::this_thread::sleep_until(next += period)) {
    Frame frame{Clock::now(), std::vector<std::uint8_t>(height * width * 3, 128), std::vector<float>(height * width)};
    for (std::size_t i = 0; i < frame.sparse_depth.size(); i += 31) frame.sparse_depth[i] = 20;
    newest.put(std::move(frame));
  }
  newest.put(std::nullopt);
}

void use(const ssdnet::Prediction& answer) {
  std::cout << answer.depth[height / 2 * width + width / 2] << " m ahead, " << answer.latency.total_ms << " ms\n";
}

int main(int count, char** arguments) try {
  if (count != 2) throw ssdnet::Error("usage: loop MODEL.onnx");
  ssdnet::Predictor predictor(arguments[1]);
  const std::vector<std::uint8_t> gray(height * width * 3, 128);
  predictor.predict(gray.data(), height, width);  // the first frame of a size is slower
  Newest newest;
  std::thread source(camera, std::ref(newest));
  int used = 0, late = 0, invalid = 0;
  while (const std::optional<Frame> frame = newest.take()) {
    const ssdnet::Prediction& answer = predictor.predict(frame->rgb.data(), height, width, 0, frame->sparse_depth.data());
    if (Clock::now() - frame->taken > deadline) ++late;
    else if (!answer.valid) ++invalid;
    else use(answer), ++used;
  }
  source.join();
  std::cout << used << " used, " << late << " late, " << invalid << " invalid, " << newest.replaced() << " replaced\n";
} catch (const std::exception& error) {
  std::cerr << "error: " << error.what() << "\n";
  return 1;
}
