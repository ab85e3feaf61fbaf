#include "formats/commit_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <limits>
#include <new>
#include <span>
#include <system_error>
#include <utility>
#include <vector>

#include "formats/error.h"

namespace strandbake {

namespace {

std::string reason(int code) {
  return std::generic_category().message(code);
}

// True where `path` still names the open file: another writer may have renamed it between our open and our lock.
bool names(const std::filesystem::path& path, const struct stat& open_file) {
  struct stat named = {};
  return ::stat(path.c_str(), &named) == 0 && named.st_dev == open_file.st_dev && named.st_ino == open_file.st_ino;
}

// A lock on the open file description: it goes with the process however that ends, and unlike HDF5's own (flock) it
// does not keep stock readers from looking at a file in progress. File systems without locks go without.
bool lock(int descriptor) {
  struct flock whole_file = {};
  whole_file.l_type = F_WRLCK;
  whole_file.l_whence = SEEK_SET;
  return ::fcntl(descriptor, F_OFD_SETLK, &whole_file) == 0 || (errno != EAGAIN && errno != EACCES);
}

// The end of the file that a superblock of version 2 or 3 names; 0 for less than one.
std::uint64_t end_named_by(const std::vector<std::byte>& superblock) {
  constexpr std::size_t kPlace = 28;  // after the signature, four bytes and two addresses
  std::uint64_t end = 0;
  for (std::size_t k = 0; k < sizeof end && kPlace + sizeof end <= superblock.size(); ++k)
    end |= std::to_integer<std::uint64_t>(superblock[kPlace + k]) << (8 * k);
  return end;
}

// A node of a chunk tree: "TREE", its kind, its level, the count of its children in two bytes, two siblings.
constexpr std::size_t kTreeNodeStart = 24;
bool is_tree_node(std::span<const std::byte> bytes) {
  return bytes.size() >= kTreeNodeStart && std::memcmp(bytes.data(), "TREE", 4) == 0;
}
int level_of(std::span<const std::byte> node) {
  return std::to_integer<int>(node[5]);
}
int child_count(std::span<const std::byte> node) {
  return std::to_integer<int>(node[6]) + 256 * std::to_integer<int>(node[7]);
}

}  // namespace

struct CommitFile::Driver {
  H5FD_t base;  // HDF5 sees this and fills it in
  CommitFile* file;

  static CommitFile& of(const H5FD_t* handle) { return *reinterpret_cast<const Driver*>(handle)->file; }

  static H5FD_t* open(const char*, unsigned, hid_t access, haddr_t) {
    const void* info = H5Pget_driver_info(access);
    if (info == nullptr) return nullptr;
    auto* driver = new (std::nothrow) Driver{};
    if (driver == nullptr) return nullptr;
    std::memcpy(&driver->file, info, sizeof driver->file);
    if (!driver->file->replays_) driver->file->truncate(0);
    return &driver->base;
  }
  static herr_t close(H5FD_t* handle) {
    of(handle).commit();
    delete reinterpret_cast<Driver*>(handle);
    return 0;
  }
  static herr_t query(const H5FD_t*, unsigned long* flags) {
    *flags = 0;  // no aggregation and no accumulator: each write arrives as it is
    return 0;
  }
  static haddr_t get_eoa(const H5FD_t* handle, H5FD_mem_t) { return of(handle).allocated_; }
  static herr_t set_eoa(H5FD_t* handle, H5FD_mem_t, haddr_t address) {
    of(handle).allocated_ = address;
    return 0;
  }
  // Never short of the allocated space, so that HDF5 does not take the held part for missing.
  static haddr_t get_eof(const H5FD_t* handle, H5FD_mem_t) { return std::max(of(handle).size_, of(handle).allocated_); }
  static herr_t read(H5FD_t* handle, H5FD_mem_t, hid_t, haddr_t address, std::size_t size, void* bytes) {
    return of(handle).read(address, bytes, size) ? 0 : -1;
  }
  static herr_t write(H5FD_t* handle, H5FD_mem_t type, hid_t, haddr_t address, std::size_t size, const void* bytes) {
    of(handle).write(type, address, bytes, size);
    return 0;
  }
  static herr_t flush(H5FD_t* handle, hid_t, hbool_t) {
    of(handle).commit();
    return 0;
  }

  static hid_t id() {
    static const hid_t registered = [] {
      H5FD_class_t driver = {};
      driver.name = "strandbake_commit";
      driver.maxaddr = static_cast<haddr_t>(std::numeric_limits<off_t>::max());
      driver.fc_degree = H5F_CLOSE_STRONG;
      driver.fapl_size = sizeof(CommitFile*);
      driver.open = open;
      driver.close = close;
      driver.query = query;
      driver.get_eoa = get_eoa;
      driver.set_eoa = set_eoa;
      driver.get_eof = get_eof;
      driver.read = read;
      driver.write = write;
      driver.flush = flush;
      return H5FDregister(&driver);
    }();
    return registered;
  }
};

CommitFile::CommitFile(const std::filesystem::path& path, bool resume) : replays_(resume) {
  const std::string deed = resume ? "opened" : "created";
  while (true) {
    descriptor_ = ::open(path.c_str(), O_RDWR | (resume ? 0 : O_CREAT) | O_CLOEXEC | O_NONBLOCK, 0666);
    if (descriptor_ < 0) throw DiskError(fmt::format("{}: cannot be {}: {}", path.string(), deed, reason(errno)));
    std::string fault;
    struct stat status = {};
    if (::fstat(descriptor_, &status) != 0) {
      fault = fmt::format("cannot be {}: {}", deed, reason(errno));
    } else if (!S_ISREG(status.st_mode)) {
      fault = "is not a regular file; choose another output";
    } else if (!lock(descriptor_)) {
      fault = "is being written by another program; wait for it or choose another output";
    } else if (names(path, status)) {
      return;
    }
    ::close(descriptor_);
    if (!fault.empty()) throw DiskError(fmt::format("{}: {}", path.string(), fault));
  }
}

CommitFile::~CommitFile() {
  ::close(descriptor_);
}

Hdf5List CommitFile::access_list() {
  Hdf5List list(H5Pcreate(H5P_FILE_ACCESS));
  CommitFile* self = this;
  // HDF5 1.8 has checksums over most metadata, so that damage is found where HDF5 1.10 would walk into it, and not yet
  // the mark of an unclosed file, with which stock readers would refuse what a killed bake leaves.
  if (list < 0 || H5Pset_driver(list, Driver::id(), &self) < 0 ||
      H5Pset_libver_bounds(list, H5F_LIBVER_V18, H5F_LIBVER_V18) < 0)
    throw DiskError("HDF5 cannot be set up: " + hdf5_error());
  return list;
}

void CommitFile::abandon() {
  fail(ECANCELED);
}

bool CommitFile::is_named(const std::filesystem::path& path) const {
  struct stat status = {};
  return ::fstat(descriptor_, &status) == 0 && names(path, status);
}

void CommitFile::sync() {
  if (error_ == 0 && ::fsync(descriptor_) != 0) fail(errno);
}

void CommitFile::fail(int code) {
  if (error_ == 0) error_ = code;
}

void CommitFile::truncate(std::uint64_t size) {
  if (error_ != 0) return;
  if (::ftruncate(descriptor_, static_cast<off_t>(size)) != 0) return fail(errno);
  size_ = size;
  sent_ = std::min(sent_, size);
}

void CommitFile::put(std::uint64_t address, const void* bytes, std::size_t size) {
  const auto* next = static_cast<const std::byte*>(bytes);
  while (error_ == 0 && size > 0) {
    const ssize_t written = ::pwrite(descriptor_, next, size, static_cast<off_t>(address));
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return fail(written < 0 ? errno : EIO);
    next += written;
    address += static_cast<std::uint64_t>(written);
    size -= static_cast<std::size_t>(written);
    size_ = std::max(size_, address);
  }
}

// Replaces metadata. A program that is killed in a write may have written the first pages of it only, so a node of a
// tree goes out page by page, in the order in which its first bytes never count children that are not there.
void CommitFile::replace(std::uint64_t address, const std::vector<std::byte>& bytes) {
  constexpr std::uint64_t kPage = 4096;
  const std::uint64_t end = address + bytes.size();
  std::array<std::byte, kTreeNodeStart> old;
  const bool replaces_node =
      is_tree_node(bytes) &&
      ::pread(descriptor_, old.data(), old.size(), static_cast<off_t>(address)) == static_cast<ssize_t>(old.size()) &&
      is_tree_node(old);
  if (!replaces_node) return put(address, bytes.data(), bytes.size());
  // Piece k ends where page k after that of `address` begins.
  const std::uint64_t first_page = address / kPage;
  const auto pieces = static_cast<std::size_t>((end - 1) / kPage - first_page + 1);
  const auto put_piece = [&](std::size_t k) {
    const std::uint64_t from = std::max(address, (first_page + k) * kPage);
    put(from, bytes.data() + (from - address), std::min(end, (first_page + k + 1) * kPage) - from);
  };
  const bool grows = level_of(old) == level_of(bytes) && child_count(old) <= child_count(bytes);
  for (std::size_t k = 0; k < pieces; ++k) put_piece(grows ? pieces - 1 - k : k);
}

// Asks the system to write now what it would keep until sync(), so that the device works while a bake computes. It is
// only a request: errors show in sync().
void CommitFile::send() {
#ifdef SYNC_FILE_RANGE_WRITE
  constexpr std::uint64_t kAtOnce = 4 << 20;
  if (error_ != 0 || size_ < sent_ + kAtOnce) return;
  ::sync_file_range(descriptor_, static_cast<off_t>(sent_), static_cast<off_t>(size_ - sent_), SYNC_FILE_RANGE_WRITE);
  sent_ = size_;
#endif
}

void CommitFile::write(H5FD_mem_t type, std::uint64_t address, const void* bytes, std::size_t size) {
  const bool is_raw = type == H5FD_MEM_DRAW;
  // What lay there before is gone.
  if (is_raw || replays_) forget(address, size);
  if (is_raw && !replays_) {
    put(address, bytes, size);
    return send();
  }
  if (is_raw && raw_is_there_) return;
  // An entry is rewritten as a whole. Should HDF5 reuse the place of another, that one has to go first.
  const auto after = held_.lower_bound(address);
  const bool meets_next = after != held_.end() && after->first < address + size &&
                          (after->first != address || after->second.bytes.size() != size);
  const bool meets_last =
      after != held_.begin() && std::prev(after)->first + std::prev(after)->second.bytes.size() > address;
  if (meets_next || meets_last) commit();
  hold(type, address, bytes, size);
}

void CommitFile::hold(H5FD_mem_t type, std::uint64_t address, const void* bytes, std::size_t size) {
  try {
    const auto* first = static_cast<const std::byte*>(bytes);
    held_.insert_or_assign(address, Held{type, {first, first + size}});
  } catch (const std::bad_alloc&) {
    fail(ENOMEM);
  }
}

// Takes a place out of what is held.
void CommitFile::forget(std::uint64_t address, std::size_t size) {
  const std::uint64_t end = address + size;
  auto entry = held_.lower_bound(address);
  if (entry != held_.begin() && std::prev(entry)->first + std::prev(entry)->second.bytes.size() > address) --entry;
  while (entry != held_.end() && entry->first < end) {
    const std::uint64_t start = entry->first;
    const Held held = std::move(entry->second);
    entry = held_.erase(entry);
    const std::uint64_t stop = start + held.bytes.size();
    if (start < address) hold(held.type, start, held.bytes.data(), address - start);
    if (stop > end) hold(held.type, end, held.bytes.data() + (end - start), stop - end);
  }
}

void CommitFile::end_replay() {
  struct stat status = {};
  if (::fstat(descriptor_, &status) != 0) return fail(errno);
  size_ = sent_ = named_ = static_cast<std::uint64_t>(status.st_size);
  replays_ = raw_is_there_ = false;
  // The small data sets. On disk they may hold a part of the frame that was never committed.
  for (auto entry = held_.begin(); entry != held_.end();) {
    if (entry->second.type == H5FD_MEM_DRAW) {
      put(entry->first, entry->second.bytes.data(), entry->second.bytes.size());
      entry = held_.erase(entry);
    } else {
      ++entry;
    }
  }
}

bool CommitFile::read(std::uint64_t address, void* bytes, std::size_t size) {
  auto* out = static_cast<std::byte*>(bytes);
  std::size_t done = 0;
  while (done < size) {
    const ssize_t count = ::pread(descriptor_, out + done, size - done, static_cast<off_t>(address + done));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) {
      fail(errno);
      return false;
    }
    if (count == 0) break;  // the rest is held, or was allocated and never written
    done += static_cast<std::size_t>(count);
  }
  std::memset(out + done, 0, size - done);
  for (const auto& [start, held] : held_) {
    const std::uint64_t first = std::max(start, address);
    const std::uint64_t last = std::min(start + held.bytes.size(), address + size);
    if (first < last) std::memcpy(out + (first - address), held.bytes.data() + (first - start), last - first);
  }
  return true;
}

// Each write below leaves a file that stock HDF5 opens, with the old frames or with the new one too:
//   1. what lies beyond the last commit: nothing names it yet;
//   2. the superblock: its end of file covers 1, which the file is long enough for, and before the first commit there
//   is none;
//   3. old nodes of the chunk trees, upper levels first: when a node was split, its parent names both halves before the
//      old half loses its second part, and a root that moves down is replaced in a single write;
//   4. the rest, by address: the object headers, which hold the dimensions. /frames/number is made last and so comes
//   last.
void CommitFile::commit() {
  if (error_ != 0) return;  // HDF5 goes on reading what is held
  if (replays_) {
    forget(allocated_, std::numeric_limits<std::uint64_t>::max() - allocated_);
    committed_ = allocated_;
    return;
  }
  const auto rank = [this](std::uint64_t address, const Held& held) {
    // The first commit makes a file of it with its last write.
    if (address >= committed_) return committed_ == 0 && held.type == H5FD_MEM_SUPER ? 1 : 0;
    if (held.type == H5FD_MEM_SUPER) return 1;
    if (held.type == H5FD_MEM_BTREE && is_tree_node(held.bytes)) return 2 + 255 - level_of(held.bytes);
    return 2 + 256;
  };
  std::vector<std::pair<int, std::uint64_t>> order;
  try {
    for (const auto& [address, held] : held_) order.emplace_back(rank(address, held), address);
  } catch (const std::bad_alloc&) {
    return fail(ENOMEM);
  }
  std::ranges::sort(order);
  const auto old = std::ranges::find_if(order, [](const auto& key) { return key.first > 0; });
  std::for_each(order.begin(), old, [this](const auto& key) {
    const Held& held = held_.at(key.second);
    put(key.second, held.bytes.data(), held.bytes.size());
  });
  // The file is never shorter than the superblock on disk says, be it the old one or the new.
  std::uint64_t names = named_;
  for (const auto& [address, held] : held_) {
    if (held.type == H5FD_MEM_SUPER && address == 0) names = end_named_by(held.bytes);
  }
  const std::uint64_t longest = std::max({allocated_, named_, names});
  if (size_ < longest) truncate(longest);
  std::for_each(old, order.end(), [this](const auto& key) { replace(key.second, held_.at(key.second).bytes); });
  if (error_ == 0) named_ = names;
  const std::uint64_t end = std::max(allocated_, named_);
  if (size_ > end) truncate(end);
  if (error_ != 0) return;
  held_.clear();
  committed_ = allocated_;
}

}  // namespace strandbake
