// Where a bake stands, beside its .part: the state of the solver after a frame that is in the file, so that a bake that
// goes on need not simulate from the start. It is a file of its own, as the cache is to have the same bytes however
// often a bake was interrupted; without it a bake that goes on takes longer and ends the same.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <span>
#include <string>

#include "formats/cache.h"

namespace strandbake {

// What a state belongs to: a digest of the provenance, and of `settings` that shape the state as well.
std::string state_identity(const CacheHeader& header, const std::string& settings);

class BakeStateFile {
 public:
  // `cache`: the name of the cache; the state lies at cache + ".part.state".
  BakeStateFile(const std::filesystem::path& cache, std::string identity);

  // Writes a state, which counts from commit() on. `save` hands bytes to its argument. Throws DiskError.
  void write(int frame, const std::function<void(const std::function<void(std::span<const std::byte>)>&)>& save);
  void commit();
  // The frame of a whole state of this identity, if there is one; load() reads it from its beginning.
  std::optional<int> find();
  // Throws InputError at the end.
  void read(std::span<std::byte> out);
  // Throws InputError where read() has left something: the state is that of another solver.
  void require_end() const;
  void remove();

 private:
  std::filesystem::path path_, new_path_;
  std::string identity_;
  std::ifstream file_;
  std::uint64_t left_ = 0;  // bytes that read() has not handed out
};

}  // namespace strandbake
