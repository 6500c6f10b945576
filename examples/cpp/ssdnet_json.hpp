// The part of ssdnet.hpp that reads JSON: the metadata of a model file, and manifests.
#pragma once

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <locale>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace ssdnet {

struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A value of a JSON document. Reading what is not there, or is of another type, throws Error.
class Json {
 public:
  static Json parse(const std::string& text) {
    Reader reader{text};
    Json value = reader.value(0);
    reader.skip_spaces();
    if (reader.at != text.size()) reader.fail();
    return value;
  }
  bool is_null() const { return type_ == Type::null; }
  double number() const { return expect(Type::number, "a number"), number_; }
  bool boolean() const { return expect(Type::boolean, "true or false"), number_ != 0; }
  const std::string& text() const { return expect(Type::text, "text"), text_; }
  const std::vector<Json>& items() const { return expect(Type::array, "a list"), items_; }
  const std::vector<std::string>& keys() const { return expect(Type::object, "an object"), keys_; }
  const Json& operator[](const std::string& key) const {
    const auto found = std::find(keys().begin(), keys().end(), key);
    if (found == keys_.end()) throw Error("the JSON document lacks the key \"" + key + "\"");
    return items_[static_cast<std::size_t>(found - keys_.begin())];
  }

 private:
  enum class Type { null, boolean, number, text, array, object };
  Type type_ = Type::null;
  double number_ = 0;
  std::string text_;
  std::vector<std::string> keys_;
  std::vector<Json> items_;

  void expect(Type type, const char* words) const {
    if (type_ != type) throw Error(std::string("the JSON document has another value where it needs ") + words);
  }

  struct Reader {
    const std::string& text;
    std::size_t at = 0;

    [[noreturn]] void fail() const { throw Error("not valid JSON at byte " + std::to_string(at)); }
    char next() {
      if (at == text.size()) fail();
      return text[at++];
    }
    void skip_spaces() {
      while (at < text.size() && std::string(" \t\r\n").find(text[at]) != std::string::npos) ++at;
    }
    bool take(char wanted) {
      skip_spaces();
      const bool found = at < text.size() && text[at] == wanted;
      at += found;
      return found;
    }
    Json value(int depth) {
      if (depth > 64) fail();
      Json read;
      if (take('"')) {
        read.type_ = Type::text, read.text_ = string();
      } else if (const bool is_object = take('{'); is_object || take('[')) {
        const char end = is_object ? '}' : ']';
        read.type_ = is_object ? Type::object : Type::array;
        for (bool first = true; !take(end); first = false) {
          if (!first && !take(',')) fail();
          if (is_object) {
            if (!take('"')) fail();
            read.keys_.push_back(string());
            if (!take(':')) fail();
          }
          read.items_.push_back(value(depth + 1));
        }
      } else if (word("null")) {
      } else if (word("true")) {
        read.type_ = Type::boolean, read.number_ = 1;
      } else if (word("false")) {
        read.type_ = Type::boolean;
      } else {
        const std::size_t end = std::min(text.find_first_not_of("+-.0123456789eE", at), text.size());
        std::istringstream digits(text.substr(at, end - at));
        digits.imbue(std::locale::classic());
        read.type_ = Type::number;
        if (!(digits >> read.number_) || digits.peek() != std::istringstream::traits_type::eof()) fail();
        at = end;
      }
      return read;
    }
    bool word(const std::string& wanted) {
      const bool found = text.compare(at, wanted.size(), wanted) == 0;
      at += found ? wanted.size() : 0;
      return found;
    }
    std::string string() {
      std::string read;
      for (char each = next(); each != '"'; each = next()) {
        if (each != '\\') {
          read += each;
          continue;
        }
        const std::string escapes = "\"\\/bfnrt", meant = "\"\\/\b\f\n\r\t";
        const char escape = next();
        if (const std::size_t place = escapes.find(escape); place != std::string::npos) {
          read += meant[place];
        } else if (escape == 'u') {
          std::uint32_t code = hex();
          if (code >> 10 == 0x36) {  // the first half of a surrogate pair
            if (next() != '\\' || next() != 'u') fail();
            const std::uint32_t low = hex();
            if (low >> 10 != 0x37) fail();
            code = 0x10000 + ((code & 0x3FF) << 10 | (low & 0x3FF));
          }
          const int more = code < 0x80 ? 0 : code < 0x800 ? 1 : code < 0x10000 ? 2 : 3;  // bytes of UTF-8
          static constexpr std::uint32_t lead[] = {0, 0xC0, 0xE0, 0xF0};
          read += static_cast<char>(lead[more] | code >> 6 * more);
          for (int left = more; left-- > 0;) read += static_cast<char>(0x80 | (code >> 6 * left & 0x3F));
        } else {
          fail();
        }
      }
      return read;
    }
    std::uint32_t hex() {
      std::uint32_t code = 0;
      for (int digit = 0; digit < 4; ++digit) {
        const std::size_t value = std::string("0123456789abcdef").find(static_cast<char>(std::tolower(next())));
        if (value == std::string::npos) fail();
        code = code << 4 | static_cast<std::uint32_t>(value);
      }
      return code;
    }
  };
};

}  // namespace ssdnet
