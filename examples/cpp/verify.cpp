// Predict the frames of a reference again, and compare the answers with the recorded ones.
//
//   ssdnet-verify reference --unpack plain    (of the Python package; docs/outputs.md describes the files)
//   ./verify plain [THREADS]
//
// Exit codes are those of ssdnet-verify: 0 the same answers; 1 error; 2 usage; 4 an answer differs by more than its
// limit, or there are no frames.
#include <fstream>
#include <iostream>
#include <iterator>
#include <map>
#include <memory>

#include "ssdnet.hpp"

namespace {

using ssdnet::Error;
using ssdnet::Json;
using ssdnet::Size;
using Figures = std::map<std::string, double>;

std::string read(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!std::filesystem::is_regular_file(path) || !file) throw Error("cannot read " + path.string() + ": unpack again");
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

// An array of version 1.0 of NumPy's format, in C order: its values and the shape, as it is printed there.
template <typename T>
std::vector<T> read_array(const std::filesystem::path& path, const std::string& shape) {
  const std::string content = read(path), type = std::is_same_v<T, float> ? "'<f4'" : "'|u1'";
  const std::string expected = "{'descr': " + type + ", 'fortran_order': False, 'shape': " + shape + ", }";
  const auto byte = [&](std::size_t at) { return static_cast<std::size_t>(static_cast<unsigned char>(content[at])); };
  const std::size_t start = content.size() < 10 ? 0 : 10 + byte(8) + 256 * byte(9);
  if (content.compare(0, 8, std::string("\x93NUMPY\x01\x00", 8)) != 0 ||
      content.compare(10, expected.size(), expected) != 0 || start > content.size())
    throw Error(path.string() + " is not the array " + expected + ": unpack again");
  std::vector<T> values((content.size() - start) / sizeof(T));
  std::copy_n(content.data() + start, values.size() * sizeof(T), reinterpret_cast<char*>(values.data()));
  return values;
}

std::string shape_of(Size size, const char* more = "") {
  return "(" + std::to_string(size.height) + ", " + std::to_string(size.width) + more + ")";
}

template <typename T>
std::vector<T> read_plane(const std::filesystem::path& path, Size size) {
  std::vector<T> values = read_array<T>(path, shape_of(size));
  if (values.size() != size.pixels()) throw Error(path.string() + " is truncated: unpack again");
  return values;
}

// The size of a picture, which is in the header alone.
Size size_of(const std::filesystem::path& path) {
  const std::string content = read(path).substr(0, 200);
  Size size;
  const std::size_t at = content.find("'shape': (");
  if (at == std::string::npos || std::sscanf(content.c_str() + at, "'shape': (%d, %d, 3)", &size.height, &size.width) != 2 ||
      std::min(size.height, size.width) < 1)
    throw Error(path.string() + " is not an array (H, W, 3): unpack again");
  return size;
}

// How far an answer is from the recorded one, by all figures that a limit may name.
template <typename T>
Figures compare(const std::vector<T>& answer, const std::vector<T>& expected) {
  double equal = 0, sum = 0, largest = 0, size = 0, most = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    const double difference = std::abs(static_cast<double>(answer[i]) - static_cast<double>(expected[i]));
    const double value = std::abs(static_cast<double>(expected[i]));
    equal += answer[i] == expected[i];
    sum += difference, size += value;
    largest = std::isnan(difference) ? difference : std::max(largest, difference);
    most = std::max(most, value);
  }
  const auto count = static_cast<double>(expected.size());
  const double mean = sum / count;
  return {{"agreement", equal / count}, {"max_abs", largest}, {"mean_abs", mean}, {"max_abs_m", largest},
          {"mean_abs_m", mean}, {"mean_relative", mean / std::max(size / count, 1e-9)},
          {"max_relative", largest / std::max(most, 1e-9)}};
}

bool is_within(const std::string& figure, double value, double limit) {
  return figure == "agreement" ? value >= limit : value <= limit;  // false for NaN
}

int verify(const std::filesystem::path& folder, int threads) {
  const Json manifest = Json::parse(read(folder / "manifest.json"));
  if (manifest["format"].text() != "ssdnet-unpacked" || manifest["version"].text() != "1.0")
    throw Error("manifest.json is of another version: unpack again");
  ssdnet::Options options;
  options.threads = threads;
  ssdnet::Predictor predictor(folder / manifest["model"]["file"].text(), options);

  std::map<std::string, Figures> worst;
  std::vector<double> times;
  std::vector<Size> warm;
  const Json& limits = manifest["limits"];
  int failed = 0;
  for (const Json& entry : manifest["frames"].items()) {
    const std::filesystem::path of_frame = folder / entry["folder"].text();
    const Size size = size_of(of_frame / "rgb.npy");
    const auto rgb = read_array<std::uint8_t>(of_frame / "rgb.npy", shape_of(size, ", 3"));
    if (rgb.size() != 3 * size.pixels()) throw Error((of_frame / "rgb.npy").string() + " is truncated: unpack again");
    const auto depth = read_plane<float>(of_frame / "sparse_depth.npy", size);
    const double focal = entry["focal_length_px"].is_null() ? 0 : entry["focal_length_px"].number();
    const std::vector<Json>& network = entry["network_size"].items();
    if (network.size() != 2) throw Error("network_size must be height and width: unpack again");
    predictor.options.network_size = {static_cast<int>(network[0].number()), static_cast<int>(network[1].number())};
    const auto predict = [&]() -> const ssdnet::Prediction& {
      return predictor.predict(rgb.data(), size.height, size.width, 0, depth.data(), focal);
    };
    if (std::find(warm.begin(), warm.end(), size) == warm.end()) {  // the first of a size is slower
      predict();
      warm.push_back(size);
    }
    const ssdnet::Prediction& answer = predict();
    times.push_back(answer.latency.total_ms);

    std::string faults;
    if (answer.valid != entry["valid"].boolean()) faults += answer.valid ? " valid" : " not valid";
    if (!entry["degraded"].is_null()) {
      std::vector<std::string> then;
      for (const Json& reason : entry["degraded"].items()) then.push_back(reason.text());
      if (then != answer.degraded) {
        faults += " degraded:";
        for (const std::string& reason : answer.degraded) faults += " " + reason;
      }
    }
    for (const std::string& head : limits.keys()) {
      const std::filesystem::path file = of_frame / (head + ".npy");
      Figures figures;
      if (!entry["valid"].boolean()) continue;
      const auto compare_floats = [&](const std::vector<float>& values) {
        if (!values.empty()) figures = compare(values, read_plane<float>(file, size));
      };
      if (head == "semantic" && !answer.semantic.empty())
        figures = compare(answer.semantic, read_plane<std::uint8_t>(file, size));
      if (head == "depth") compare_floats(answer.depth);
      if (head == "boundary") compare_floats(answer.boundary);
      if (head == "depth_uncertainty") compare_floats(answer.depth_uncertainty);
      if (figures.empty()) {
        faults += " no " + head;
        continue;
      }
      for (const std::string& name : limits[head].keys()) {
        if (figures.count(name) == 0) throw Error("unknown limit " + name + ": unpack again");
        const double value = figures[name];
        const auto [kept, is_new] = worst[head].emplace(name, value);
        if (!is_new && !is_within(name, value, kept->second)) kept->second = value;
        if (!is_within(name, value, limits[head][name].number())) faults += " " + head + " " + name;
      }
    }
    if (faults.empty()) continue;
    ++failed;
    std::cout << entry["name"].text() << ":" << faults << "\n";
  }
  for (const auto& [head, figures] : worst)
    for (const auto& [name, value] : figures)
      std::cout << head << " " << name << " " << value << ", limit " << limits[head][name].number() << "\n";
  if (times.empty()) {
    std::cout << "the reference holds no frames: nothing was compared\n";
    return 4;
  }
  std::sort(times.begin(), times.end());
  std::cout << times.size() << " frames, p50 " << times[times.size() / 2] << " ms, p99 "
            << times[(times.size() * 99) / 100] << " ms\n";
  if (failed > 0) std::cout << failed << " of " << times.size() << " frames differ from the reference\n";
  else std::cout << "the same answers\n";
  return failed > 0 ? 4 : 0;
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 2 || count > 3) {
    std::cerr << "usage: verify UNPACKED_FOLDER [THREADS]\n";
    return 2;
  }
  try {
    return verify(arguments[1], count == 3 ? std::max(1, std::atoi(arguments[2])) : 0);
  } catch (const std::exception& error) {
    std::cerr << "error: " << error.what() << "\n";
    return 1;
  }
}
