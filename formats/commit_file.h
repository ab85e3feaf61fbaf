// A file that HDF5 writes through us (a virtual file driver), for two things that its own driver cannot do:
//
// - Killed between any two writes, the file stays the HDF5 file of the last commit or becomes that of the next. Raw
// data
//   goes to the file at once, to places that no metadata names yet. Metadata is held back until HDF5 flushes, and then
//   goes out in an order in which each single write leaves a valid file (see commit()).
// - The first error sticks and every later write is dropped, so that a full disk leaves the last commit on disk and
// HDF5,
//   which believes that all is well, closes without a complaint, a leak or a hang.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <vector>

#include "formats/hdf5_handle.h"

namespace strandbake {

class CommitFile {
 public:
  // Creates the file or takes over one that no living writer holds. Throws DiskError.
  explicit CommitFile(const std::filesystem::path& path);
  ~CommitFile();
  CommitFile(const CommitFile&) = delete;
  CommitFile& operator=(const CommitFile&) = delete;

  // For H5Fcreate, which empties the file.
  Hdf5List access_list();
  // errno of the first failure, 0 where there was none.
  int error() const { return error_; }
  // Drops everything that was not committed, now and later.
  void abandon();
  // Brings the bytes to the device; a failure shows in error().
  void sync();

 private:
  struct Driver;  // the callbacks, and HDF5's part of an open file
  struct Held {
    H5FD_mem_t type;
    std::vector<std::byte> bytes;
  };

  void truncate(std::uint64_t size);
  void put(std::uint64_t address, const void* bytes, std::size_t size);
  void write(H5FD_mem_t type, std::uint64_t address, const void* bytes, std::size_t size);
  void send();
  bool read(std::uint64_t address, void* bytes, std::size_t size);
  void commit();
  void fail(int code);

  int descriptor_ = -1;
  int error_ = 0;
  std::uint64_t allocated_ = 0;         // HDF5's end of the address space
  std::uint64_t committed_ = 0;         // the same at the last commit: nothing on disk names a place beyond
  std::uint64_t size_ = 0;              // of the file on disk
  std::uint64_t sent_ = 0;              // bytes before this place were asked to be written to the device
  std::map<std::uint64_t, Held> held_;  // metadata by address
};

}  // namespace strandbake
