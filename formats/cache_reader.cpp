#include <fmt/format.h>
#include <libdeflate.h>

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstring>
#include <mutex>
#include <new>
#include <stdexcept>
#include <string_view>

#include "formats/cache.h"
#include "formats/hdf5_handle.h"

namespace strandbake {

namespace {

constexpr int kNewestFormatVersion = 1;

// No chunk larger than this is read: HDF5 unpacks a chunk in memory as a whole. Ours have 192 KiB.
constexpr std::uint64_t kLargestChunkBytes = std::uint64_t{1} << 30;

// Deflate packs 1032 : 1 at best (258 bytes in two bits), so a filtered data set that claims more is lying.
constexpr std::uint64_t kLargestRatio = 1032;

using Dims = std::vector<hsize_t>;

// What is wrong with the file; the caller puts its name in front and the advice behind.
[[noreturn]] void damaged(const std::string& what) {
  throw InputError(what);
}

hid_t require(hid_t id, const std::string& what) {
  if (id < 0) damaged(fmt::format("{}: {}", what, hdf5_error()));
  return id;
}

struct Dataset {
  std::string name;
  Hdf5Dataset id;
  Hdf5Type type;
  std::size_t value_bytes = 0;
  Dims dims;
  Dims chunk;                         // empty: contiguous
  std::vector<H5Z_filter_t> filters;  // in the order of writing: shuffle and deflate, or one of them, or none
  std::uint64_t stored = 0;           // bytes in the file

  hsize_t count() const {
    hsize_t product = 1;
    for (const hsize_t dim : dims) product *= dim;  // cannot overflow: open_dataset() has seen to it
    return product;
  }
};

std::uint64_t element_count(const Dims& dims, std::uint64_t limit, const std::string& name) {
  std::uint64_t count = 1;
  for (const hsize_t dim : dims)
    if (__builtin_mul_overflow(count, dim, &count)) damaged(fmt::format("{} has impossible dimensions", name));
  if (count > limit) damaged(fmt::format("{} claims {} values, more than its bytes can hold", name, count));
  return count;
}

Dataset open_dataset(hid_t file, std::uint64_t file_bytes, const std::string& name, std::size_t rank) {
  Dataset set;
  set.name = name;
  set.id = Hdf5Dataset(require(H5Dopen2(file, name.c_str(), H5P_DEFAULT), name));
  const Hdf5Space space(require(H5Dget_space(set.id), name));
  const bool plain = H5Sget_simple_extent_type(space) == (rank == 0 ? H5S_SCALAR : H5S_SIMPLE);
  if (!plain || H5Sget_simple_extent_ndims(space) != static_cast<int>(rank))
    damaged(fmt::format("{} does not have {} dimensions", name, rank));
  set.dims.resize(rank);
  if (rank > 0 && H5Sget_simple_extent_dims(space, set.dims.data(), nullptr) < 0) damaged(name + ": " + hdf5_error());
  set.type = Hdf5Type(require(H5Dget_type(set.id), name));
  set.value_bytes = H5Tget_size(set.type);
  if (set.value_bytes == 0 || set.value_bytes > file_bytes) damaged(name + " has impossible values");

  const Hdf5List list(require(H5Dget_create_plist(set.id), name));
  const H5D_layout_t layout = H5Pget_layout(list);
  if ((layout != H5D_CHUNKED && layout != H5D_CONTIGUOUS) || H5Pget_external_count(list) != 0)
    damaged(name + " is not stored in the file itself");
  std::uint64_t chunk_bytes = 0;
  if (layout == H5D_CHUNKED) {
    set.chunk.resize(rank);
    if (rank == 0 || H5Pget_chunk(list, static_cast<int>(rank), set.chunk.data()) != static_cast<int>(rank) ||
        std::ranges::count(set.chunk, hsize_t{0}) != 0)
      damaged(name + " has impossible chunks");
    chunk_bytes =
        set.value_bytes * element_count(set.chunk, kLargestChunkBytes / set.value_bytes, "a chunk of " + name);
    for (int k = 0; k < H5Pget_nfilters(list); ++k) {
      unsigned flags = 0;
      std::size_t none = 0;
      set.filters.push_back(
          H5Pget_filter2(list, static_cast<unsigned>(k), &flags, &none, nullptr, 0, nullptr, nullptr));
      if (set.filters.back() != H5Z_FILTER_SHUFFLE && set.filters.back() != H5Z_FILTER_DEFLATE)
        damaged(name + " is packed with another filter than shuffle and deflate");
    }
    if (set.filters.size() > 2) damaged(name + " has too many filters");
  }
  const hsize_t storage = H5Dget_storage_size(set.id);
  // H5Dread_chunk() goes by the size in the file, and only a filtered chunk can tell it beforehand.
  hsize_t chunks = 0;
  if (!set.chunk.empty() && set.filters.empty() &&
      (H5Dget_num_chunks(set.id, space, &chunks) < 0 || storage != chunks * chunk_bytes))
    damaged(name + " has a chunk of a wrong size");
  set.stored = std::min<std::uint64_t>(storage, file_bytes);
  const std::uint64_t ratio = set.filters.empty() ? 1 : kLargestRatio;
  element_count(set.dims, set.stored * ratio / set.value_bytes, name);
  return set;
}

// A data set of numbers of exactly this type.
Dataset open_numbers(hid_t file, std::uint64_t file_bytes, const std::string& name, std::size_t rank, hid_t type) {
  Dataset set = open_dataset(file, file_bytes, name, rank);
  if (H5Tequal(set.type, type) <= 0) damaged(name + " has another type of numbers than format version 1");
  return set;
}

struct FreeDecompressor {
  void operator()(libdeflate_decompressor* decompressor) const { libdeflate_free_decompressor(decompressor); }
};

// What shuffle has parted: the lowest bytes of all values, then the next ones, ...
void unshuffle(std::span<const std::byte> from, std::size_t value_bytes, std::byte* out) {
  const std::size_t count = from.size() / value_bytes;
  if (value_bytes == sizeof(std::uint32_t)) {
    const auto* const bytes = reinterpret_cast<const std::uint8_t*>(from.data());
    for (std::size_t k = 0; k < count; ++k) {
      const std::uint32_t value = bytes[k] | std::uint32_t{bytes[count + k]} << 8 |
                                  std::uint32_t{bytes[2 * count + k]} << 16 | std::uint32_t{bytes[3 * count + k]} << 24;
      std::memcpy(out + 4 * k, &value, 4);
    }
  } else {
    for (std::size_t value = 0; value < count; ++value)
      for (std::size_t byte = 0; byte < value_bytes; ++byte)
        out[value * value_bytes + byte] = from[byte * count + value];
  }
  std::ranges::copy(from.subspan(count * value_bytes), out + count * value_bytes);  // no whole value: left as it was
}

// Memory for one chunk, kept by each thread: pages that are handed back and taken again for each cost more than what
// is done with them.
struct Scratch {
  std::vector<std::byte> bytes, unpacked;
  std::unique_ptr<libdeflate_decompressor, FreeDecompressor> decompressor;
};

// Undoes the filters of the chunk in `scratch.bytes`, where the result is, too. HDF5 1.10 itself would trust a chunk to
// unpack to the right size, and read beyond its end where a damaged one does not.
void unpack(const Dataset& set, std::uint32_t skipped, std::size_t chunk_bytes, Scratch& scratch) {
  for (std::size_t k = set.filters.size(); k-- > 0;) {
    if ((skipped >> k & 1U) != 0) continue;
    const std::vector<std::byte>& bytes = scratch.bytes;
    std::vector<std::byte>& out = scratch.unpacked;
    if (set.filters[k] == H5Z_FILTER_DEFLATE) {
      if (bytes.size() < chunk_bytes / kLargestRatio) damaged(set.name + " has a chunk that is too short");
      out.resize(chunk_bytes);
      if (scratch.decompressor == nullptr) scratch.decompressor.reset(libdeflate_alloc_decompressor());
      if (scratch.decompressor == nullptr) throw std::bad_alloc();
      if (libdeflate_zlib_decompress(scratch.decompressor.get(), bytes.data(), bytes.size(), out.data(), out.size(),
                                     nullptr) != LIBDEFLATE_SUCCESS)
        damaged(set.name + " has a chunk that cannot be unpacked");
    } else {
      out.resize(bytes.size());
      unshuffle(bytes, set.value_bytes, out.data());
    }
    scratch.bytes.swap(scratch.unpacked);
  }
  if (scratch.bytes.size() != chunk_bytes) damaged(set.name + " has a chunk of a wrong size");
}

// Rows and columns of a data set, each from the first to before the end. What lies behind a column comes with it.
struct Box {
  std::array<hsize_t, 2> first;
  std::array<hsize_t, 2> end;
};

// Copies what lies in the box of one chunk to `out`, which begins at the first of the box.
void copy_chunk(const Dataset& set, std::span<const std::byte> chunk, std::array<hsize_t, 3> corner, const Box& box,
                std::byte* out) {
  std::array<hsize_t, 3> dims = {1, 1, 1};
  std::array<hsize_t, 3> shape = {1, 1, 1};
  std::ranges::copy(set.dims, dims.begin());
  std::ranges::copy(set.chunk, shape.begin());
  const auto low = [&](std::size_t axis) { return std::max(corner[axis], box.first[axis]); };
  const auto high = [&](std::size_t axis) { return std::min(corner[axis] + shape[axis], box.end[axis]); };
  const hsize_t columns = box.end[1] - box.first[1];
  const bool is_whole = shape[2] == dims[2];  // behind each column: they follow each other
  const hsize_t run = is_whole && high(1) > low(1) ? high(1) - low(1) : 1;
  const hsize_t bytes = run * (std::min(corner[2] + shape[2], dims[2]) - corner[2]) * set.value_bytes;
  for (hsize_t x = low(0); x < high(0); ++x)
    for (hsize_t y = low(1); y < high(1); y += run) {
      const hsize_t from = ((x - corner[0]) * shape[1] + (y - corner[1])) * shape[2];
      const hsize_t to = ((x - box.first[0]) * columns + (y - box.first[1])) * dims[2] + corner[2];
      std::memcpy(out + to * set.value_bytes, chunk.data() + from * set.value_bytes, bytes);
    }
}

// HDF5 is one thread's at a time.
std::mutex hdf5_mutex;

// A box of a data set of one to three dimensions; `out` has room for it. Any number of threads may read at once.
void read_box(const Dataset& set, const Box& box, void* out) {
  static_assert(std::endian::native == std::endian::little, "the values of the file are copied as they are");
  if (box.first[0] >= box.end[0] || box.first[1] >= box.end[1]) return;
  if (set.chunk.empty()) {
    const std::lock_guard lock(hdf5_mutex);
    const QuietHdf5 quiet;
    Dims start(set.dims.size());
    Dims extent = set.dims;
    for (std::size_t axis = 0; axis < std::min<std::size_t>(set.dims.size(), 2); ++axis) {
      start[axis] = box.first[axis];
      extent[axis] = box.end[axis] - box.first[axis];
    }
    const Hdf5Space space(require(H5Dget_space(set.id), set.name));
    const Hdf5Space memory(
        require(H5Screate_simple(static_cast<int>(extent.size()), extent.data(), nullptr), set.name));
    if (H5Sselect_hyperslab(space, H5S_SELECT_SET, start.data(), nullptr, extent.data(), nullptr) < 0 ||
        H5Dread(set.id, set.type, memory, space, H5P_DEFAULT, out) < 0)
      damaged(fmt::format("{} cannot be read: {}", set.name, hdf5_error()));
    return;
  }
  std::array<hsize_t, 3> step = {1, 1, 1};
  std::array<hsize_t, 3> end = {1, 1, 1};
  std::ranges::copy(set.chunk, step.begin());
  std::ranges::copy(set.dims, end.begin());
  std::ranges::copy(box.end, end.begin());
  const std::size_t chunk_bytes = step[0] * step[1] * step[2] * set.value_bytes;
  thread_local Scratch scratch;
  const auto read = [&](const std::array<hsize_t, 3>& corner) {
    const std::lock_guard lock(hdf5_mutex);
    const QuietHdf5 quiet;
    hsize_t stored = 0;
    if (H5Dget_chunk_storage_size(set.id, corner.data(), &stored) < 0 || stored == 0 || stored > set.stored)
      damaged(fmt::format("{} lacks a part of row {}", set.name, std::max(box.first[0], corner[0])));
    scratch.bytes.resize(stored);
    std::uint32_t skipped = 0;
    if (H5Dread_chunk(set.id, H5P_DEFAULT, corner.data(), &skipped, scratch.bytes.data()) < 0)
      damaged(fmt::format("{} cannot be read: {}", set.name, hdf5_error()));
    return skipped;
  };
  std::array<hsize_t, 3> corner = {};
  for (corner[0] = box.first[0] / step[0] * step[0]; corner[0] < end[0]; corner[0] += step[0])
    for (corner[1] = box.first[1] / step[1] * step[1]; corner[1] < end[1]; corner[1] += step[1])
      for (corner[2] = 0; corner[2] < end[2]; corner[2] += step[2]) {
        unpack(set, read(corner), chunk_bytes, scratch);
        copy_chunk(set, scratch.bytes, corner, box, static_cast<std::byte*>(out));
      }
  constexpr std::size_t kKept = std::size_t{1} << 22;
  if (scratch.bytes.capacity() + scratch.unpacked.capacity() > kKept) scratch = {};
}

// Rows first .. first + count - 1.
void read_rows(const Dataset& set, hsize_t first, hsize_t count, void* out) {
  read_box(set, {{first, 0}, {first + count, set.dims.size() > 1 ? set.dims[1] : 1}}, out);
}

std::vector<std::string> read_text(hid_t file, std::uint64_t file_bytes, const std::string& name, std::size_t rank) {
  const Dataset set = open_dataset(file, file_bytes, name, rank);
  if (H5Tget_class(set.type) != H5T_STRING || H5Tis_variable_str(set.type) != 0)
    damaged(name + " does not hold strings of fixed length");
  std::string bytes(set.count() * set.value_bytes, '\0');
  if (rank > 0) {
    read_rows(set, 0, set.dims[0], bytes.data());
  } else if (H5Dread(set.id, set.type, H5S_ALL, H5S_ALL, H5P_DEFAULT, bytes.data()) < 0) {
    damaged(fmt::format("{} cannot be read: {}", name, hdf5_error()));
  }
  std::vector<std::string> lines;
  for (std::size_t start = 0; start < bytes.size(); start += set.value_bytes) {
    const std::string_view padded = std::string_view(bytes).substr(start, set.value_bytes);
    lines.emplace_back(padded.substr(0, padded.find('\0')));
  }
  return lines;
}

Hdf5Attribute open_scalar_attribute(hid_t object, const char* name) {
  Hdf5Attribute attribute(require(H5Aopen(object, name, H5P_DEFAULT), fmt::format("attribute \"{}\"", name)));
  const Hdf5Space space(require(H5Aget_space(attribute), name));
  if (H5Sget_simple_extent_npoints(space) != 1) damaged(fmt::format("attribute \"{}\" is not one value", name));
  return attribute;
}

// A number of exactly this type.
template <class T>
T read_attribute(hid_t object, const char* name, hid_t file_type) {
  const Hdf5Attribute attribute = open_scalar_attribute(object, name);
  const Hdf5Type found(require(H5Aget_type(attribute), name));
  T value = {};
  if (H5Tequal(found, file_type) <= 0 || H5Aread(attribute, found, &value) < 0)
    damaged(fmt::format("attribute \"{}\" is not the number it should be", name));
  return value;
}

std::string read_text_attribute(hid_t object, const char* name) {
  const Hdf5Attribute attribute = open_scalar_attribute(object, name);
  const Hdf5Type type(require(H5Aget_type(attribute), name));
  std::string text;
  if (H5Tget_class(type) == H5T_STRING && H5Tis_variable_str(type) == 0) text.resize(H5Tget_size(type));
  if (text.empty() || H5Aread(attribute, type, text.data()) < 0)
    damaged(fmt::format("attribute \"{}\" is not a text", name));
  text.resize(std::min(text.find('\0'), text.size()));
  return text;
}

bool has(hid_t file, const char* name) {
  return H5Lexists(file, name, H5P_DEFAULT) > 0;
}

bool is_strandbake(hid_t file) {
  try {
    return H5Aexists(file, "format") > 0 && read_text_attribute(file, "format") == "strandbake";
  } catch (const InputError&) {
    return false;
  }
}

int deflate_level(hid_t dataset) {
  const Hdf5List list(require(H5Dget_create_plist(dataset), "/frames/position"));
  unsigned flags = 0;
  std::array<unsigned, 1> level = {};
  std::size_t count = level.size();
  if (H5Pget_filter_by_id2(list, H5Z_FILTER_DEFLATE, &flags, &count, level.data(), 0, nullptr, nullptr) < 0) return 0;
  return static_cast<int>(std::clamp(level[0], 0U, 9U));
}

// Changes with every write to a file.
struct FileMoment {
  std::uint64_t size = 0;
  std::filesystem::file_time_type time;

  explicit FileMoment(const std::filesystem::path& path) {
    std::error_code ignored;
    size = std::filesystem::file_size(path, ignored);
    time = std::filesystem::last_write_time(path, ignored);
  }
  bool operator==(const FileMoment&) const = default;
};

}  // namespace

struct CacheReader::Impl {
  std::string path;
  Hdf5File file;
  CacheHeader header;
  CacheOptions options;
  bool complete = false;
  std::size_t frames = 0;
  std::vector<std::int32_t> number;
  std::vector<double> time;
  std::vector<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> head;
  std::vector<Sphere> colliders;  // of all frames
  std::vector<float> stretch, residual, penetration;
  std::vector<std::int32_t> substeps;
  Dataset position, velocity;

  void open(const std::filesystem::path& cache) {
    std::error_code error;
    const auto status = std::filesystem::status(cache, error);
    if (!std::filesystem::exists(status)) throw InputError("there is no such file");
    if (std::filesystem::is_directory(status)) throw InputError("is a folder, not a cache");
    if (!std::filesystem::is_regular_file(status)) throw InputError("is not a regular file");
    const std::uint64_t bytes = std::filesystem::file_size(cache, error);
    if (error) throw InputError("cannot be read: " + error.message());

    const Hdf5List access(require(H5Pcreate(H5P_FILE_ACCESS), "HDF5"));
    H5Pset_file_locking(access, false, true);  // a bake in progress may be looked at
    file = Hdf5File(H5Fopen(cache.c_str(), H5F_ACC_RDONLY, access));
    if (file < 0) {
      const std::string cause = hdf5_error();
      throw InputError(H5Fis_hdf5(cache.c_str()) > 0
                           ? fmt::format("is a damaged or truncated HDF5 file ({}); bake it again", cause)
                           : fmt::format("is not an HDF5 file, or cannot be read ({})", cause));
    }
    if (!is_strandbake(file)) throw InputError("is an HDF5 file, but not a Strandbake cache");
    const int version = read_attribute<int>(file, "format_version", H5T_STD_I32LE);
    if (version > kNewestFormatVersion)
      throw InputError(
          fmt::format("has cache format version {}, but this program reads up to {}; use a newer Strandbake", version,
                      kNewestFormatVersion));
    try {
      if (version < 1) damaged(fmt::format("format version {} has never been", version));
      read_strands(bytes);
      read_provenance(bytes);
      read_frames(bytes);
    } catch (const InputError& fault) {
      throw InputError(fmt::format("is damaged: {}; bake it again", fault.what()));
    }
  }

  void read_strands(std::uint64_t bytes) {
    header.fps = read_attribute<double>(file, "fps", H5T_IEEE_F64LE);
    if (!(std::isfinite(header.fps) && header.fps > 0)) damaged(fmt::format("fps is {}", header.fps));

    const Dataset rest = open_numbers(file, bytes, "/rest/position", 2, H5T_IEEE_F32LE);
    if (rest.dims[1] != 3) damaged("/rest/position does not have 3 columns");
    header.rest_position.resize(rest.dims[0]);
    read_rows(rest, 0, rest.dims[0], header.rest_position.data());

    const Dataset offset = open_numbers(file, bytes, "/strands/offset", 1, H5T_STD_U64LE);
    if (offset.dims[0] < 2) damaged("/strands/offset has no strand");
    header.offset.resize(offset.dims[0]);
    read_rows(offset, 0, offset.dims[0], header.offset.data());
    if (header.offset.front() != 0) damaged(fmt::format("/strands/offset starts at {}", header.offset.front()));
    const auto fall = std::ranges::adjacent_find(header.offset, std::greater_equal());
    if (fall != header.offset.end())
      damaged(fmt::format("/strands/offset does not increase at strand {}", fall - header.offset.begin()));
    if (header.offset.back() != rest.dims[0])
      damaged(fmt::format("/strands/offset ends at {}, but there are {} vertices", header.offset.back(), rest.dims[0]));
    const std::size_t strands = header.offset.size() - 1;

    header.region_names = read_text(file, bytes, "/regions/name", 1);
    const Dataset region = open_numbers(file, bytes, "/strands/region", 1, H5T_STD_U32LE);
    if (region.dims[0] != strands)
      damaged(fmt::format("/strands/region has {} values for {} strands", region.dims[0], strands));
    header.region.resize(strands);
    read_rows(region, 0, region.dims[0], header.region.data());
    for (std::size_t strand = 0; strand < strands; ++strand)
      if (header.region[strand] >= header.region_names.size())
        damaged(fmt::format("strand {} is in region {}, but there are {}", strand, header.region[strand],
                            header.region_names.size()));

    if (has(file, "/strands/root_uv")) {
      const Dataset root_uv = open_numbers(file, bytes, "/strands/root_uv", 2, H5T_IEEE_F32LE);
      if (root_uv.dims != Dims{strands, 2}) damaged("/strands/root_uv does not have two values for each strand");
      header.root_uv.resize(strands);
      read_rows(root_uv, 0, root_uv.dims[0], header.root_uv.data());
    }
  }

  void read_provenance(std::uint64_t bytes) {
    const Hdf5Group group(require(H5Gopen2(file, "/provenance", H5P_DEFAULT), "/provenance"));
    header.program_version = read_text_attribute(group, "version");
    header.scene_text = read_text(file, bytes, "/provenance/scene", 0).at(0);
    const auto read_pairs = [&](const std::string& name, const std::string& value_name) {
      std::vector<std::string> names = read_text(file, bytes, name + "/name", 1);
      std::vector<std::string> values = read_text(file, bytes, name + "/" + value_name, 1);
      if (names.size() != values.size())
        damaged(fmt::format("{} has {} names and {} values", name, names.size(), values.size()));
      std::vector<std::pair<std::string, std::string>> pairs;
      for (std::size_t k = 0; k < names.size(); ++k) pairs.emplace_back(std::move(names[k]), std::move(values[k]));
      return pairs;
    };
    header.inputs = read_pairs("/provenance/inputs", "sha256");
    header.parameters = read_pairs("/provenance/parameters", "value");
  }

  // What a killed bake leaves may have one frame more in one data set than in another: those that all have count.
  void read_frames(std::uint64_t bytes) {
    const hsize_t vertices = header.rest_position.size();
    const auto open_frames = [&](const char* name, const Dims& shape, hid_t type) {
      Dataset set = open_numbers(file, bytes, name, 1 + shape.size(), type);
      if (!std::equal(shape.begin(), shape.end(), set.dims.begin() + 1))
        damaged(fmt::format("a frame of {} has another shape than {}", name, fmt::join(shape, " x ")));
      return set;
    };
    position = open_frames("/frames/position", {vertices, 3}, H5T_IEEE_F32LE);
    options.deflate = deflate_level(position.id);
    options.precision = read_attribute<double>(position.id, "precision", H5T_IEEE_F64LE);
    if (!(std::isfinite(options.precision) && options.precision >= 0))
      damaged(fmt::format("the precision of /frames/position is {}", options.precision));
    const Dataset numbers = open_frames("/frames/number", {}, H5T_STD_I32LE);
    const Dataset times = open_frames("/frames/time", {}, H5T_IEEE_F64LE);
    const Dataset heads = open_frames("/frames/head", {4, 4}, H5T_IEEE_F64LE);
    std::vector<hsize_t> counts = {position.dims[0], numbers.dims[0], times.dims[0], heads.dims[0]};
    options.velocity = has(file, "/frames/velocity");
    if (options.velocity) {
      velocity = open_frames("/frames/velocity", {vertices, 3}, H5T_IEEE_F32LE);
      counts.push_back(velocity.dims[0]);
    }
    Dataset spheres;
    if (has(file, "/frames/collider")) {
      spheres = open_numbers(file, bytes, "/frames/collider", 3, H5T_IEEE_F64LE);
      if (spheres.dims[2] != 4) damaged("/frames/collider does not have four numbers for each collider");
      header.colliders = spheres.dims[1];
      counts.push_back(spheres.dims[0]);
    }
    options.stats = has(file, "/stats");
    Dataset stretches;
    Dataset residuals;
    Dataset penetrations;
    Dataset substep_counts;
    if (options.stats) {
      stretches = open_frames("/stats/largest_stretch", {}, H5T_IEEE_F32LE);
      residuals = open_frames("/stats/residual", {}, H5T_IEEE_F32LE);
      penetrations = open_frames("/stats/deepest_penetration", {}, H5T_IEEE_F32LE);
      substep_counts = open_frames("/stats/substeps", {}, H5T_STD_I32LE);
      counts.insert(counts.end(), {stretches.dims[0], residuals.dims[0], penetrations.dims[0], substep_counts.dims[0]});
    }
    const auto [fewest, most] = std::ranges::minmax(counts);
    complete = read_attribute<std::uint8_t>(file, "complete", H5T_STD_U8LE) != 0;
    if (complete && fewest != most)
      damaged(fmt::format("it calls itself complete, but has {} to {} frames", fewest, most));
    frames = fewest;

    read_first_frames(numbers, number);
    read_first_frames(times, time);
    read_first_frames(heads, head);
    if (header.colliders > 0) {
      colliders.resize(frames * header.colliders);
      read_rows(spheres, 0, frames, colliders.data());
    }
    if (options.stats) {
      read_first_frames(stretches, stretch);
      read_first_frames(residuals, residual);
      read_first_frames(penetrations, penetration);
      read_first_frames(substep_counts, substeps);
    }
  }

  template <class T>
  void read_first_frames(const Dataset& set, std::vector<T>& out) const {
    out.resize(frames);
    read_rows(set, 0, frames, out.data());
  }

  void read_vectors(const Dataset& set, std::size_t index, std::size_t first, std::span<Eigen::Vector3f> out) const {
    check(index);
    if (first > header.rest_position.size() || out.size() > header.rest_position.size() - first)
      throw std::out_of_range(fmt::format("cache: vertices {} to {}", first, first + out.size()));
    try {
      read_box(set, {{index, first}, {index + 1, first + out.size()}}, out.data());
    } catch (const InputError& fault) {
      throw InputError(fmt::format("{}: is damaged: {}; bake it again", path, fault.what()));
    }
  }

  void read_all_vectors(const Dataset& set, std::size_t index, std::span<Eigen::Vector3f> out) const {
    if (out.size() != header.rest_position.size()) throw std::invalid_argument("cache: room for each vertex is needed");
    read_vectors(set, index, 0, out);
  }

  void check(std::size_t index) const {
    if (index >= frames) throw std::out_of_range(fmt::format("cache: frame index {} of {}", index, frames));
  }
};

CacheReader::CacheReader(const std::filesystem::path& path) {
  const QuietHdf5 quiet;
  // A bake in progress may commit a frame between two looks at its file, which do not fit together then.
  using Clock = std::chrono::steady_clock;
  const Clock::time_point patience = Clock::now() + std::chrono::seconds(10);
  while (impl_ == nullptr) {
    const FileMoment before(path);
    auto impl = std::make_unique<Impl>();
    impl->path = path.string();
    try {
      impl->open(path);
      impl_ = std::move(impl);
    } catch (const InputError& fault) {
      if (before == FileMoment(path) || Clock::now() > patience)
        throw InputError(fmt::format("{}: {}", path.string(), fault.what()));
    } catch (const std::bad_alloc&) {
      throw InputError(fmt::format("{}: needs more memory than there is", path.string()));
    }
  }
}

CacheReader::~CacheReader() = default;
CacheReader::CacheReader(CacheReader&&) noexcept = default;
CacheReader& CacheReader::operator=(CacheReader&&) noexcept = default;

const CacheHeader& CacheReader::header() const {
  return impl_->header;
}
const CacheOptions& CacheReader::options() const {
  return impl_->options;
}
std::size_t CacheReader::frame_count() const {
  return impl_->frames;
}
std::size_t CacheReader::vertex_count() const {
  return impl_->header.rest_position.size();
}
bool CacheReader::complete() const {
  return impl_->complete;
}
bool CacheReader::has_velocity() const {
  return impl_->options.velocity;
}
std::uint64_t CacheReader::stored_bytes() const {
  return impl_->position.stored;
}

int CacheReader::frame_number(std::size_t index) const {
  impl_->check(index);
  return impl_->number[index];
}

double CacheReader::frame_time(std::size_t index) const {
  impl_->check(index);
  return impl_->time[index];
}

Eigen::Isometry3d CacheReader::head(std::size_t index) const {
  impl_->check(index);
  return Eigen::Isometry3d(Eigen::Matrix4d(impl_->head[index]));
}

std::span<const Sphere> CacheReader::colliders(std::size_t index) const {
  impl_->check(index);
  const std::size_t count = impl_->header.colliders;
  return std::span(impl_->colliders).subspan(index * count, count);
}

std::optional<FrameStats> CacheReader::stats(std::size_t index) const {
  impl_->check(index);
  if (!impl_->options.stats) return std::nullopt;
  return FrameStats{impl_->stretch[index], impl_->residual[index], impl_->penetration[index], impl_->substeps[index]};
}

void CacheReader::read_position(std::size_t index, std::span<Eigen::Vector3f> out) const {
  impl_->read_all_vectors(impl_->position, index, out);
}

std::size_t CacheReader::block_vertices() const {
  constexpr hsize_t kUnpacked = 16384;  // where nothing is packed, any number will do
  const Dims& chunk = impl_->position.chunk;
  return static_cast<std::size_t>(std::min<hsize_t>(chunk.empty() ? kUnpacked : chunk[1], vertex_count()));
}

std::size_t CacheReader::packed_bytes(Vectors which, std::size_t index, std::size_t first) const {
  impl_->check(index);
  const Dataset& set = which == Vectors::Position ? impl_->position : impl_->velocity;
  const std::lock_guard lock(hdf5_mutex);
  const QuietHdf5 quiet;
  const std::array<hsize_t, 3> corner = {index, first, 0};
  hsize_t stored = 0;
  if (set.chunk.empty() || H5Dget_chunk_storage_size(set.id, corner.data(), &stored) < 0 || stored == 0 ||
      stored > set.stored)
    throw InputError(fmt::format("{}: is damaged: {} lacks a part of row {}", impl_->path, set.name, index));
  return stored;
}

std::vector<std::byte> CacheReader::read_packed(Vectors which, std::size_t index, std::size_t first) const {
  std::vector<std::byte> bytes(packed_bytes(which, index, first));
  const Dataset& set = which == Vectors::Position ? impl_->position : impl_->velocity;
  const std::lock_guard lock(hdf5_mutex);
  const QuietHdf5 quiet;
  const std::array<hsize_t, 3> corner = {index, first, 0};
  std::uint32_t skipped = 0;
  if (H5Dread_chunk(set.id, H5P_DEFAULT, corner.data(), &skipped, bytes.data()) < 0)
    throw InputError(fmt::format("{}: is damaged: {} cannot be read: {}", impl_->path, set.name, hdf5_error()));
  return bytes;
}

void CacheReader::read_position(std::size_t index, std::size_t first, std::span<Eigen::Vector3f> out) const {
  impl_->read_vectors(impl_->position, index, first, out);
}

void CacheReader::read_velocity(std::size_t index, std::span<Eigen::Vector3f> out) const {
  if (!has_velocity()) throw std::logic_error("cache: there are no velocities");
  impl_->read_all_vectors(impl_->velocity, index, out);
}

}  // namespace strandbake
