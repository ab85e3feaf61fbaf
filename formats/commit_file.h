// A file that HDF5 writes through us (a virtual file driver), for two things that its own driver cannot do:
//
// - Killed between any two writes, the file stays the HDF5 file of the last commit or becomes that of the next. Raw
//   data goes to the file at once, to places that no metadata names yet. Metadata is held back until HDF5 flushes, and
//   then goes out in an order in which each single write leaves a valid file (see commit()).
// - The first error sticks and every later write is dropped, so that a full disk leaves the last commit on disk and
//   HDF5, which believes that all is well, closes without a complaint, a leak or a hang.
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
  // Creates the file or takes over one that no living writer holds. Throws DiskError. `resume`: it must exist and keeps
  // what it holds, see below.
  explicit CommitFile(const std::filesystem::path& path, bool resume = false);
  ~CommitFile();
  CommitFile(const CommitFile&) = delete;
  CommitFile& operator=(const CommitFile&) = delete;

  // For H5Fcreate, which empties the file.
  Hdf5List access_list();
  // errno of the first failure, 0 where there was none.
  int error() const { return error_; }
  // Drops everything that was not committed, now and later.
  void abandon();
  // Whether the file still goes by this name.
  bool is_named(const std::filesystem::path& path) const;
  // Brings the bytes to the device; a failure shows in error().
  void sync();

  // To go on with a file, its writer repeats all calls that made it, commit by commit: as the same calls put the same
  // bytes in the same places, nothing has to be written, and HDF5 ends up as it was. Metadata is held back until the
  // next commit, which writes it again; while `is_there` is set, raw data is taken for what the file has. This ends it.
  void end_replay();
  void set_raw_is_there(bool is_there) { raw_is_there_ = is_there; }

 private:
  struct Driver;  // the callbacks, and HDF5's part of an open file
  struct Held {
    H5FD_mem_t type;
    std::vector<std::byte> bytes;
  };

  void truncate(std::uint64_t size);
  void put(std::uint64_t address, const void* bytes, std::size_t size);
  void replace(std::uint64_t address, const std::vector<std::byte>& bytes);
  void write(H5FD_mem_t type, std::uint64_t address, const void* bytes, std::size_t size);
  void hold(H5FD_mem_t type, std::uint64_t address, const void* bytes, std::size_t size);
  void forget(std::uint64_t address, std::size_t size);
  void send();
  bool read(std::uint64_t address, void* bytes, std::size_t size);
  void commit();
  void fail(int code);

  int descriptor_ = -1;
  int error_ = 0;
  bool replays_ = false;
  bool raw_is_there_ = false;
  std::uint64_t allocated_ = 0;         // HDF5's end of the address space
  std::uint64_t committed_ = 0;         // the same at the last commit: nothing on disk names a place beyond
  std::uint64_t size_ = 0;              // of the file on disk
  std::uint64_t named_ = 0;             // what the superblock on disk names as its end, at most
  std::uint64_t sent_ = 0;              // bytes before this place were asked to be written to the device
  std::map<std::uint64_t, Held> held_;  // metadata by address
};

}  // namespace strandbake
