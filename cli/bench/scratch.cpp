#include "cli/bench/scratch.h"

#include <fmt/format.h>

#include <cerrno>
#include <cstdlib>
#include <fstream>
#include <string>
#include <system_error>

#include "formats/error.h"

namespace strandbake {

Scratch::Scratch(const std::filesystem::path& parent) {
  std::string name = (parent / "strandbake-bench-XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr) {
    throw DiskError(fmt::format("{}: cannot be created: {}", name, std::generic_category().message(errno)));
  }
  folder_ = name;
}

Scratch::~Scratch() {
  std::error_code ignored;  // nothing is lost with a file that stays
  std::filesystem::remove_all(folder_, ignored);
}

void write_text_file(const std::filesystem::path& path, const std::string& text) {
  std::ofstream out(path, std::ios::binary);
  out << text;
  out.close();
  if (!out) throw DiskError(fmt::format("{}: cannot be written", path.string()));
}

}  // namespace strandbake
