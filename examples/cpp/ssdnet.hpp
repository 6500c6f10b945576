// ssdnet.hpp: predict with a model file of ssdnet in C++17. It needs ONNX Runtime's C++ headers and the standard library.
//
//   ssdnet::Predictor predictor("ssdnet-lite.onnx", options);
//   const ssdnet::Prediction& answer = predictor.predict(rgb, height, width, stride, sparse_depth, focal_length);
//   if (answer.valid) use(answer.depth);
//
// The rules are those of docs/model_file.md, in the order of runtime/engine of the Python package, and the answers are
// the same. Failures throw ssdnet::Error, whose text says what to do; the predictor stays usable.
//
// Threads: one call of `predict` at a time for each Predictor, whose buffers hold the answer until the next call.
// Different predictors are independent. ONNX Runtime itself uses `Options::threads` threads for an operator.
#pragma once

#include <onnxruntime_cxx_api.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "ssdnet_anchor.hpp"
#include "ssdnet_json.hpp"
#include "ssdnet_resize.hpp"

namespace ssdnet {

struct ClassInfo {
  std::string name;
  std::array<std::uint8_t, 3> color{};  // red, green, blue
};

// What the model file states about itself.
struct Contract {
  std::string model_name, precision;
  std::vector<ClassInfo> classes;  // in the order of the ids; empty without `semantic`
  double max_depth_m = 0;          // the range, in canonical metres if there are any
  int trained_height = 0;          // 0 = not known
  double canonical_focal_px = 0;   // 0 = plain metres

  static Contract parse(const std::string& text) {
    const Json document = Json::parse(text);
    Contract read;
    if (const std::string& version = document["schema_version"].text(); version != "1.4")
      throw Error("schema version " + version + ", and this header reads 1.4: export the model again, or take the "
                  "header of the version that wrote it");
    read.model_name = document["model_name"].text();
    read.precision = document["precision"].text();
    for (const Json& entry : document["classes"].items()) {
      ClassInfo info{entry["name"].text(), {}};
      if (entry["color"].items().size() != 3) throw Error("the color of " + info.name + " must be red, green and blue");
      for (std::size_t i = 0; i < 3; ++i)
        info.color[i] = static_cast<std::uint8_t>(between(entry["color"].items()[i], "color", 0, 255));
      read.classes.push_back(info);
    }
    if (read.classes.size() > 255) throw Error("more than 255 classes");
    read.max_depth_m = between(document["max_depth_m"], "max_depth_m", 1, 10'000);
    if (const Json& rows = document["trained_height"]; !rows.is_null())
      read.trained_height = static_cast<int>(between(rows, "trained_height", 32, 16'384));
    if (const Json& focal = document["canonical_focal_px"]; !focal.is_null())
      read.canonical_focal_px = between(focal, "canonical_focal_px", 1, 1e6);
    return read;
  }

 private:
  static double between(const Json& value, const std::string& name, double least, double most) {
    if (!(value.number() >= least && value.number() <= most)) throw Error(name + " is out of range");
    return value.number();
  }
};

struct Latency {
  double preprocess_ms = 0, inference_ms = 0, postprocess_ms = 0, total_ms = 0;
};

// The answers for a frame, at its own size, row by row. A head that the model lacks is empty.
struct Prediction {
  std::vector<std::uint8_t> semantic;    // class ids
  std::vector<float> depth;              // metres along the optical axis
  std::vector<float> boundary;           // probability of a boundary between classes
  std::vector<float> depth_uncertainty;  // metres: the scale of a Laplace distribution
  bool valid = false;                    // false: do not use the answers; `degraded` says why
  std::vector<std::string> degraded;     // "no_depth", "sparse_depth_low", "image_constant", "depth_not_finite" ...
  Size frame_size, network_size;
  std::size_t depth_returns = 0;  // depth pixels of the frame that were used
  double range_m = 0;             // no answer is farther
  Latency latency;
};

struct Options {
  // Size at which the network runs; the answers have the frame's. {0, 0}: the trained height with the aspect kept, for
  // frames that are larger by more than a quarter, else the frame's own; {rows, 0}: rows, with the aspect kept;
  // {height, width}: this one.
  Size network_size;
  int threads = 0;  // within an operator; 0 = ONNX Runtime's choice, the physical cores
  std::function<void(Ort::SessionOptions&)> session;  // adds an execution provider, for example
};

class Predictor {
 public:
  Options options;  // `network_size` may change between calls

  // Open a model file, and answer an empty frame with it once.
  explicit Predictor(const std::filesystem::path& model, Options wanted = {}) : options(std::move(wanted)) {
    const std::string name = model.string();
    if (!std::filesystem::is_regular_file(model))
      throw Error("no model file at " + name + ": give an ONNX file that ssdnet-export wrote");
    if (OrtGetApiBase()->GetApi(ORT_API_VERSION) == nullptr)
      throw Error("the ONNX Runtime that is loaded is older than the headers of this program: compile with its own");
    try {
      env_ = Ort::Env(ORT_LOGGING_LEVEL_FATAL, "ssdnet");  // errors are exceptions
      Ort::SessionOptions session;
      session.SetIntraOpNumThreads(options.threads);
      session.SetInterOpNumThreads(1);
      session.SetGraphOptimizationLevel(ORT_ENABLE_ALL);
      session.AddConfigEntry("session.intra_op.allow_spinning", "0");  // no core is busy between the frames
      session.AddConfigEntry("session.inter_op.allow_spinning", "0");
      if (options.session) options.session(session);
      session_ = Ort::Session(env_, model.c_str(), session);
      Ort::AllocatorWithDefaultOptions allocator;
      const auto document = session_.GetModelMetadata().LookupCustomMetadataMapAllocated("ssdnet", allocator);
      if (!document) throw Error("it has no metadata \"ssdnet\"");
      contract_ = Contract::parse(document.get());
      read_tensors();
    } catch (const std::exception& error) {
      throw Error("cannot use the model " + name + " (" + error.what() + "): get it again, or export it again with "
                  "ssdnet-export");
    }
    const Size size = fixed_size_.height != 0 ? fixed_size_ : Size{64, 64};
    const std::vector<std::uint8_t> gray(size.pixels() * 3, 128);
    for (const std::string& reason : predict(gray.data(), size.height, size.width).degraded)
      if (reason.find("_not_finite") != std::string::npos)
        throw Error("the answer of " + name + " to an empty frame is not finite (" + reason + "): export it again");
  }

  const Contract& contract() const { return contract_; }

  // The size at which the network runs for a frame.
  Size network_size(Size frame) const {
    const Size wanted = options.network_size;
    if (fixed_size_.height != 0) {
      if (wanted.height != 0 && wanted != fixed_size_)
        throw Error("the model has the fixed size " + shown(fixed_size_) + ": leave network_size out");
      return fixed_size_;
    }
    if (wanted.height != 0 && wanted.width != 0) return checked(wanted, "network_size");
    int rows = wanted.height;
    if (rows == 0 && contract_.trained_height != 0 && frame.height > 1.25 * contract_.trained_height)
      rows = contract_.trained_height;
    if (rows == 0) return frame;
    const double width = std::nearbyint(static_cast<double>(frame.width) * rows / frame.height);
    return checked({rows, std::max(32, static_cast<int>(width))}, "network_size");
  }

  // Predict a frame.
  //
  // rgb: height x width x 3 bytes, RGB, not BGR; rows start `stride` bytes apart, 0 = without a gap.
  // sparse_depth: height x width metres along the optical axis, 0 = no return; null = the camera alone. NaN, Inf,
  //   negative values, and those beyond both the range and 250 m, are no returns; others are clipped to the range.
  // focal_length: fx of the camera in pixels of this frame; 0 = not known.
  //
  // The answer is valid until the next call.
  const Prediction& predict(const std::uint8_t* rgb, int height, int width, std::size_t stride = 0,
                            const float* sparse_depth = nullptr, double focal_length = 0) {
    const auto started = Clock::now();
    const Size frame = checked({height, width}, "the frame");
    const std::size_t row_bytes = static_cast<std::size_t>(width) * 3;
    if (rgb == nullptr) throw Error("the frame is empty: give its pixels, RGB");
    if (stride != 0 && stride < row_bytes)
      throw Error("stride = " + std::to_string(stride) + " bytes, and a row of this frame has " + std::to_string(row_bytes));
    if (focal_length != 0 && !(focal_length >= 1 && focal_length <= 1e6))
      throw Error("focal_length must be 1 to 1000000 pixels, or 0: give fx of the camera's matrix");
    const Size size = network_size(frame);
    answer_.frame_size = frame;
    answer_.network_size = size;
    answer_.degraded.clear();
    double factor = 1;  // from metres to those of the canonical camera
    if (contract_.canonical_focal_px != 0 && focal_length != 0)
      factor = contract_.canonical_focal_px /
               (focal_length * std::sqrt(static_cast<double>(size.pixels()) / static_cast<double>(frame.pixels())));
    answer_.range_m = contract_.max_depth_m / factor;

    const std::uint8_t* packed = rgb;
    if (stride > row_bytes) {
      packed_.resize(frame.pixels() * 3);
      for (std::size_t row = 0; row < static_cast<std::size_t>(height); ++row)
        std::copy_n(rgb + row * stride, row_bytes, packed_.data() + row * row_bytes);
      packed = packed_.data();
    }
    clean(sparse_depth, frame);
    std::size_t fed_returns = answer_.depth_returns;
    const std::uint8_t* fed_rgb = packed;
    std::vector<float>* fed = &cleaned_;
    if (size != frame) {
      network_rgb_.resize(size.pixels() * 3);
      resizing::image(packed, frame, network_rgb_.data(), size, 3, scratch_rgb_);
      fed_rgb = network_rgb_.data();
      moved_.resize(size.pixels());
      resizing::move_returns(cleaned_.data(), frame, moved_.data(), size);
      fed = &moved_;
      fed_returns = size.pixels() - static_cast<std::size_t>(std::count(moved_.begin(), moved_.end(), 0.0f));
    }
    if (factor != 1) {  // rounding must not move the farthest return out of the range
      const auto scale = static_cast<float>(factor), most = static_cast<float>(answer_.range_m * factor);
      for (float& depth : *fed) depth = std::min(depth * scale, most);
    }
    if (answer_.depth_returns == 0) {
      answer_.degraded.emplace_back("no_depth");
    } else if (covers_little(*fed, size, fed_returns)) {
      answer_.degraded.emplace_back("sparse_depth_low");
    }
    if (is_constant(packed, frame)) answer_.degraded.emplace_back("image_constant");
    const auto ran = Clock::now();
    run(fed_rgb, fed->data(), size, size == frame);
    const auto answered = Clock::now();
    judge();
    to_frame(factor);
    const auto ended = Clock::now();
    answer_.latency = {ms(ran - started), ms(answered - ran), ms(ended - answered), ms(ended - started)};
    return answer_;
  }

 private:
  using Clock = std::chrono::steady_clock;
  enum class Rule { surface, bilinear, nearest };
  struct Head {  // of floats; `semantic` is the only one of bytes
    const char* name;
    bool is_metres;
    double most;  // share of the range of metres
    Rule rule;
    std::vector<float> Prediction::*values;
  };
  static const std::array<Head, 3>& heads() {
    static const double any = std::numeric_limits<double>::infinity();
    static const std::array<Head, 3> all{{{"depth", true, 1, Rule::surface, &Prediction::depth},
                                          {"boundary", false, 1, Rule::bilinear, &Prediction::boundary},
                                          {"depth_uncertainty", true, any, Rule::nearest, &Prediction::depth_uncertainty}}};
    return all;
  }

  Ort::Env env_{nullptr};
  Ort::Session session_{nullptr};
  Contract contract_;
  Size fixed_size_;
  bool has_semantic_ = false;
  std::vector<const Head*> has_;
  Prediction answer_;
  Prediction network_;  // the answers at the network's size, where it is not the frame's
  std::vector<std::uint8_t> packed_, network_rgb_, scratch_rgb_;
  std::vector<float> cleaned_, moved_, scratch_;

  static double ms(Clock::duration time) { return std::chrono::duration<double, std::milli>(time).count(); }
  static std::string shown(Size size) { return std::to_string(size.height) + " x " + std::to_string(size.width); }
  static Size checked(Size size, const std::string& name) {
    if (std::min(size.height, size.width) < 32 || std::max(size.height, size.width) > 16'384 || size.pixels() > 64'000'000)
      throw Error(name + " is " + shown(size) + ": sides must be 32 to 16384 pixels, and 64 million pixels at most");
    return size;
  }

  // What the graph takes and gives.
  void read_tensors() {
    Ort::AllocatorWithDefaultOptions allocator;
    const auto is = [](const Ort::TypeInfo& type, ONNXTensorElementDataType element, std::size_t axes) {
      if (type.GetONNXType() != ONNX_TYPE_TENSOR) return false;
      const auto tensor = type.GetTensorTypeAndShapeInfo();
      return tensor.GetElementType() == element && tensor.GetShape().size() == axes;
    };
    bool fits = session_.GetInputCount() == 2;
    for (std::size_t i = 0; fits && i < 2; ++i) {
      const std::string name = session_.GetInputNameAllocated(i, allocator).get();
      const Ort::TypeInfo type = session_.GetInputTypeInfo(i);
      fits = (name == "rgb" && is(type, ONNX_TENSOR_ELEMENT_DATA_TYPE_UINT8, 4)) ||
             (name == "sparse_depth" && is(type, ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT, 3));
      if (fits && name == "sparse_depth") {
        const std::vector<std::int64_t> shape = type.GetTensorTypeAndShapeInfo().GetShape();
        if (shape[1] > 0 && shape[2] > 0)
          fixed_size_ = checked({static_cast<int>(std::min<std::int64_t>(shape[1], 16'385)),
                                 static_cast<int>(std::min<std::int64_t>(shape[2], 16'385))}, "the model's size");
      }
    }
    for (std::size_t i = 0; fits && i < session_.GetOutputCount(); ++i) {
      const std::string name = session_.GetOutputNameAllocated(i, allocator).get();
      const Ort::TypeInfo type = session_.GetOutputTypeInfo(i);
      if (name == "semantic") has_semantic_ = fits = is(type, ONNX_TENSOR_ELEMENT_DATA_TYPE_UINT8, 3);
      for (const Head& head : heads())
        if (name == head.name) {
          fits = is(type, ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT, 3);
          has_.push_back(&head);
        }
    }
    if (!fits || (!has_semantic_ && has_.empty())) throw Error("its graph takes or gives other tensors");
  }

  // Into `cleaned_`: depth without what is no return.
  void clean(const float* sparse_depth, Size frame) {
    cleaned_.assign(frame.pixels(), 0.0f);
    answer_.depth_returns = 0;
    if (sparse_depth == nullptr) return;
    const auto range = static_cast<float>(answer_.range_m);
    const auto farthest = static_cast<float>(std::max(answer_.range_m, 250.0));  // the range of automotive LiDARs
    for (std::size_t i = 0; i < cleaned_.size(); ++i) {
      const float depth = sparse_depth[i];
      // 16 bits without a measurement, in KITTI's units, millimetres and centimetres.
      const bool saturated = depth == 65535.0f / 256 || depth == 65535.0f / 1000 || depth == 65535.0f / 100;
      if (depth > 0 && depth <= farthest && !saturated) {  // false for NaN
        cleaned_[i] = std::min(depth, range);
        ++answer_.depth_returns;
      }
    }
  }

  // Whether returns lie in less than 1 % of 128 x 416 cells of the image.
  static bool covers_little(const std::vector<float>& depth, Size size, std::size_t returns) {
    const std::int64_t rows = std::min(128, size.height), columns = std::min(416, size.width);
    const double needed = 0.01 * static_cast<double>(rows * columns);
    const std::int64_t largest = ((size.height + rows - 1) / rows) * ((size.width + columns - 1) / columns);
    if (static_cast<double>(returns) >= needed * static_cast<double>(largest)) return false;
    std::vector<std::uint8_t> occupied(static_cast<std::size_t>(rows * columns));
    for (std::int64_t row = 0, at = 0; row < size.height; ++row)
      for (std::int64_t column = 0; column < size.width; ++column, ++at)
        if (depth[static_cast<std::size_t>(at)] > 0)
          occupied[static_cast<std::size_t>(row * rows / size.height * columns + column * columns / size.width)] = 1;
    return static_cast<double>(std::count(occupied.begin(), occupied.end(), 1)) < needed;
  }

  static bool is_constant(const std::uint8_t* rgb, Size size) {  // usually ends at the second pixel
    return std::equal(rgb + 3, rgb + size.pixels() * 3, rgb);
  }

  // Run the session; its outputs are written where the answers are kept.
  void run(const std::uint8_t* rgb, const float* depth, Size size, bool is_frame_size) {
    Prediction& to = is_frame_size ? answer_ : network_;
    const Ort::MemoryInfo memory = Ort::MemoryInfo::CreateCpu(OrtDeviceAllocator, OrtMemTypeDefault);
    const std::array<std::int64_t, 4> shape{1, size.height, size.width, 3};
    const char* inputs[] = {"rgb", "sparse_depth"};
    const Ort::Value feeds[] = {  // ONNX Runtime does not write to its inputs
        Ort::Value::CreateTensor(memory, const_cast<std::uint8_t*>(rgb), size.pixels() * 3, shape.data(), 4),
        Ort::Value::CreateTensor(memory, const_cast<float*>(depth), size.pixels(), shape.data(), 3)};
    std::vector<const char*> names;
    std::vector<Ort::Value> outputs;
    const auto give = [&](const char* name, auto& values) {
      values.resize(size.pixels());
      names.push_back(name);
      outputs.push_back(Ort::Value::CreateTensor(memory, values.data(), values.size(), shape.data(), 3));
    };
    if (has_semantic_) give("semantic", to.semantic);
    for (const Head* head : has_) give(head->name, to.*head->values);
    try {
      session_.Run(Ort::RunOptions{nullptr}, inputs, feeds, 2, names.data(), outputs.data(), names.size());
    } catch (const Ort::Exception& error) {
      throw Error("the session failed on a frame of " + shown(size) + " (" + error.what() + "): if memory is short, use "
                  "a smaller network_size");
    }
  }

  // Whether the outputs can be used; the reasons go to `degraded`.
  void judge() {
    const Prediction& from = outputs();
    const std::size_t before = answer_.degraded.size();
    if (has_semantic_) {
      const std::uint8_t most = *std::max_element(from.semantic.begin(), from.semantic.end());
      if (most == 255) answer_.degraded.emplace_back("semantic_not_finite");
      else if (most >= contract_.classes.size()) answer_.degraded.emplace_back("semantic_unknown_class");
    }
    for (const Head* head : has_) {
      float low = std::numeric_limits<float>::infinity(), high = -low;
      bool finite = true;
      for (const float value : from.*head->values) {
        finite &= std::isfinite(value);
        low = std::min(low, value), high = std::max(high, value);
      }
      const double most = head->most * (head->is_metres ? contract_.max_depth_m : 1);
      const double margin = std::isfinite(most) ? 1e-3 * most : 0;  // arithmetic may leave the range by so much
      if (!finite) answer_.degraded.push_back(std::string(head->name) + "_not_finite");
      else if (low < static_cast<float>(-margin) || high > static_cast<float>(most + margin))
        answer_.degraded.push_back(std::string(head->name) + "_out_of_range");
    }
    answer_.valid = answer_.degraded.size() == before;
  }

  Prediction& outputs() { return answer_.network_size == answer_.frame_size ? answer_ : network_; }

  // The outputs in metres, and at the frame's size.
  void to_frame(double factor) {
    const Size frame = answer_.frame_size, size = answer_.network_size;
    Prediction& from = outputs();
    for (const Head* head : has_)
      if (factor != 1 && head->is_metres)
        for (float& value : from.*head->values) value *= static_cast<float>(1 / factor);
    if (size == frame) return;
    if (answer_.depth_returns > 0 && size.height <= frame.height && size.width <= frame.width && !from.depth.empty())
      anchoring::move_to_returns(from.depth.data(), from.depth_uncertainty.empty() ? nullptr : from.depth_uncertainty.data(),
                                 size, cleaned_.data(), frame, static_cast<float>(answer_.range_m));
    for (const Head* head : has_) {
      std::vector<float>&values = from.*head->values, &answer = answer_.*head->values;
      answer.resize(frame.pixels());
      switch (head->rule) {
        case Rule::surface: resizing::surface(values.data(), size, answer.data(), frame); break;
        case Rule::bilinear: resizing::image(values.data(), size, answer.data(), frame, 1, scratch_); break;
        case Rule::nearest: resizing::nearest(values.data(), size, answer.data(), frame); break;
      }
    }
    if (!has_semantic_) return;
    answer_.semantic.resize(frame.pixels());
    resizing::nearest(from.semantic.data(), size, answer_.semantic.data(), frame);
  }
};

}  // namespace ssdnet
