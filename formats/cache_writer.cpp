#include <fcntl.h>
#include <fmt/format.h>
#include <libdeflate.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <exception>
#include <fstream>
#include <limits>
#include <mutex>
#include <numeric>
#include <stdexcept>
#include <system_error>

#include "formats/cache.h"
#include "formats/commit_file.h"
#include "formats/hdf5_handle.h"

namespace strandbake {

namespace {

constexpr int kFormatVersion = 1;

// Vertices in a chunk, at most. 192 KiB of positions: five such chunks fit the 1 MiB that HDF5 readers cache by
// default, HDF5's own work per chunk (20 us) is small beside deflating it (1 ms), and a groom of 200,000 vertices still
// keeps a dozen threads busy.
constexpr std::size_t kChunkVertices = 16384;

// Frames in a chunk of the small data sets (numbers, times, matrices, statistics).
constexpr hsize_t kSmallChunkFrames = 64;

// A collider is stored as the four numbers that it is.
static_assert(sizeof(Sphere) == 4 * sizeof(double));

using Dims = std::vector<hsize_t>;

hid_t require(hid_t id) {
  if (id < 0) throw DiskError(hdf5_error());
  return id;
}

void require(bool good) {
  if (!good) throw DiskError(hdf5_error());
}

// The largest power of two that is not above `precision`; at least 2^-200, of which every float is a multiple.
double rounding_step(double precision) {
  int exponent = 0;
  std::frexp(precision, &exponent);
  return std::ldexp(1.0, std::max(exponent - 1, -200));
}

// Without branches, so that compilers make vectors of it.
inline float round_to_step(float v, double step, double inverse_step) {
  // Adding and subtracting 1.5 * 2^52 rounds a double below 2^51 to an integer, ties to even. All else here is exact.
  constexpr double kShift = 6755399441055744.0;
  const double steps = static_cast<double>(v) * inverse_step;
  const double rounded = ((steps + kShift) - kShift) * step;
  // A multiple already, infinite or NaN; or the nearest multiple is no float.
  const bool is_rounded =
      std::abs(steps) < 0x1p51 && std::abs(rounded) <= static_cast<double>(std::numeric_limits<float>::max());
  return is_rounded ? static_cast<float>(rounded) : v;
}

struct FreeCompressor {
  void operator()(libdeflate_compressor* compressor) const { libdeflate_free_compressor(compressor); }
};

// The vectors of one data set in one frame.
struct Vectors {
  hid_t dataset;
  std::optional<hsize_t> frame;                // none: the data set has no frames
  std::span<const Eigen::Vector3f> in_memory;  // [vertices], or made by `make`
  std::function<void(std::size_t first, std::span<Eigen::Vector3f> out)> make;
  double precision;
};

// Cuts vectors into chunks, encodes them as HDF5's filters would (shuffle, then deflate), and hands them over in their
// order. Chunks are of equal size, the last one padded with zeros, because HDF5 wants whole chunks; cutting evenly
// keeps the padding below one vertex a chunk.
//
// Threads take chunks in order and encode them into slots. Whoever finds the next one ready, and nobody writing, writes
// it: HDF5 sees one thread at a time and always the same order. There are a few more slots than threads, so that
// nobody has to wait because of one slow chunk or a write.
class ChunkQueue {
 public:
  using Write = std::function<void(const Vectors&, std::size_t first_vertex, std::span<const std::uint8_t> bytes)>;

  // All memory is taken here.
  ChunkQueue(std::size_t vertices, int level, int threads, bool makes_vectors, Write write)
      : vertices_(vertices),
        level_(level),
        chunk_count_((vertices + kChunkVertices - 1) / kChunkVertices),
        chunk_vertices_((vertices + chunk_count_ - 1) / chunk_count_),
        write_(std::move(write)) {
    const std::size_t chunk_bytes = chunk_vertices_ * sizeof(Eigen::Vector3f);
    workers_.resize(std::min<std::size_t>(static_cast<std::size_t>(threads), chunk_count_ * (makes_vectors ? 2 : 1)));
    for (Worker& worker : workers_) {
      if (level > 0) {
        worker.compressor.reset(libdeflate_alloc_compressor(level));
        if (worker.compressor == nullptr) throw std::bad_alloc();
        worker.shuffled = std::make_unique_for_overwrite<std::uint8_t[]>(chunk_bytes);
      }
      if (makes_vectors) worker.made = std::make_unique_for_overwrite<Eigen::Vector3f[]>(chunk_vertices_);
      idle_.push_back(&worker);
    }
    capacity_ = level > 0 ? libdeflate_zlib_compress_bound(nullptr, chunk_bytes) : chunk_bytes;
    slots_.resize(2 * workers_.size() + 1);
    for (Slot& slot : slots_) slot.room = std::make_unique_for_overwrite<std::uint8_t[]>(capacity_);
  }

  std::size_t chunk_vertices() const { return chunk_vertices_; }

  void start(std::vector<Vectors> all) {
    all_ = std::move(all);
    count_ = all_.size() * chunk_count_;
    taken_ = written_ = 0;
    failure_ = nullptr;
  }
  bool done() const { return written_ == count_ || failure_; }
  void rethrow() const {
    if (failure_) std::rethrow_exception(failure_);
  }

  void work(bool may_wait) noexcept {
    std::unique_lock lock(mutex_);
    if (idle_.empty()) return;  // as many are here as have room
    Worker& worker = *idle_.back();
    idle_.pop_back();
    while (!done()) {
      Slot& next = slots_[written_ % slots_.size()];
      if (next.ready && !is_writing_) {
        is_writing_ = true;
        attempt(lock, [&] { write_(all_[written_ / chunk_count_], first_vertex(written_), next.bytes); });
        is_writing_ = false;
        next.ready = false;
        ++written_;
      } else if (taken_ < count_ && taken_ < written_ + slots_.size()) {
        const std::size_t chunk = taken_++;
        Slot& slot = slots_[chunk % slots_.size()];
        attempt(lock, [&] { encode(worker, chunk, slot); });
        slot.ready = true;
      } else if (may_wait) {
        changed_.wait(lock);
        continue;
      } else {
        break;
      }
      changed_.notify_all();
    }
    idle_.push_back(&worker);
  }

 private:
  struct Worker {
    std::unique_ptr<libdeflate_compressor, FreeCompressor> compressor;
    std::unique_ptr<std::uint8_t[]> shuffled;
    std::unique_ptr<Eigen::Vector3f[]> made;
  };
  struct Slot {
    std::unique_ptr<std::uint8_t[]> room;
    std::span<const std::uint8_t> bytes;  // in `room`, or where the caller has them
    bool ready = false;
  };

  template <class Step>
  void attempt(std::unique_lock<std::mutex>& lock, const Step& step) {
    std::exception_ptr thrown;
    lock.unlock();
    try {
      step();
    } catch (...) {
      thrown = std::current_exception();
    }
    lock.lock();
    if (thrown && !failure_) failure_ = thrown;
  }

  std::size_t first_vertex(std::size_t chunk) const { return chunk % chunk_count_ * chunk_vertices_; }

  void encode(Worker& worker, std::size_t chunk, Slot& slot) const {
    const Vectors& vectors = all_[chunk / chunk_count_];
    const std::size_t first = first_vertex(chunk);
    const std::size_t vertices = std::min(chunk_vertices_, vertices_ - first);
    std::span<const Eigen::Vector3f> from;
    if (vectors.make) {
      vectors.make(first, {worker.made.get(), vertices});
      from = {worker.made.get(), vertices};
    } else {
      from = vectors.in_memory.subspan(first, vertices);
    }
    const bool rounds = vectors.precision > 0;
    const bool is_whole = vertices == chunk_vertices_;
    if (level_ == 0 && !rounds && is_whole && !vectors.make && std::endian::native == std::endian::little) {
      slot.bytes = {reinterpret_cast<const std::uint8_t*>(from.data()), from.size_bytes()};
      return;
    }
    const double step = rounds ? rounding_step(vectors.precision) : 1;
    const double inverse_step = 1 / step;
    const float* const in = from[0].data();
    const std::size_t count = 3 * vertices;
    if (rounds) {
      store(worker, slot, count, [=](std::size_t k) { return round_to_step(in[k], step, inverse_step); });
    } else {
      store(worker, slot, count, [in](std::size_t k) { return in[k]; });
    }
  }

  template <class Value>
  void store(Worker& worker, Slot& slot, std::size_t count, const Value& value) const {
    const std::size_t padded = 3 * chunk_vertices_;
    if (level_ == 0) {
      std::uint8_t* const out = slot.room.get();
      for (std::size_t k = 0; k < count; ++k) {
        const auto bits = std::bit_cast<std::uint32_t>(value(k));
        for (int byte = 0; byte < 4; ++byte) out[4 * k + byte] = static_cast<std::uint8_t>(bits >> (8 * byte));
      }
      std::fill(out + 4 * count, out + 4 * padded, std::uint8_t{0});
      slot.bytes = {out, 4 * padded};
      return;
    }
    std::uint8_t* const out = worker.shuffled.get();  // the lowest bytes of all numbers, then the next ones, ...
    for (std::size_t k = 0; k < count; ++k) {
      const auto bits = std::bit_cast<std::uint32_t>(value(k));
      for (int byte = 0; byte < 4; ++byte) out[byte * padded + k] = static_cast<std::uint8_t>(bits >> (8 * byte));
    }
    for (int byte = 0; byte < 4; ++byte)
      std::fill(out + byte * padded + count, out + (byte + 1) * padded, std::uint8_t{0});
    slot.bytes = {slot.room.get(),
                  libdeflate_zlib_compress(worker.compressor.get(), out, 4 * padded, slot.room.get(), capacity_)};
  }

  std::size_t vertices_;
  int level_;
  std::size_t chunk_count_;
  std::size_t chunk_vertices_;
  std::size_t capacity_ = 0;
  Write write_;
  std::vector<Worker> workers_;
  std::vector<Slot> slots_;  // chunk c lies in slot c % size
  std::vector<Vectors> all_;

  // All below is guarded by the mutex.
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<Worker*> idle_;
  std::size_t count_ = 0;    // chunks of all vectors
  std::size_t taken_ = 0;    // [0, taken_) were taken
  std::size_t written_ = 0;  // [0, written_) are written
  bool is_writing_ = false;
  std::exception_ptr failure_;
};

Hdf5Group make_group(hid_t parent, const char* name) {
  const Hdf5List list(require(H5Pcreate(H5P_GROUP_CREATE)));
  require(H5Pset_obj_track_times(list, false) >= 0);
  return Hdf5Group(require(H5Gcreate2(parent, name, H5P_DEFAULT, list, H5P_DEFAULT)));
}

// Contiguous where `chunk` is empty. Chunked data sets start with no frames where `frames` is set.
Hdf5Dataset make_dataset(hid_t parent, const char* name, hid_t type, const Dims& dims, const Dims& chunk = {},
                         int level = 0, bool frames = false) {
  Dims limit = dims;
  if (frames) limit[0] = H5S_UNLIMITED;
  const Hdf5Space space(require(dims.empty()
                                    ? H5Screate(H5S_SCALAR)
                                    : H5Screate_simple(static_cast<int>(dims.size()), dims.data(), limit.data())));
  const Hdf5List list(require(H5Pcreate(H5P_DATASET_CREATE)));
  require(H5Pset_obj_track_times(list, false) >= 0);
  if (!chunk.empty()) require(H5Pset_chunk(list, static_cast<int>(chunk.size()), chunk.data()) >= 0);
  // All bytes are written by us, but for the unused frames at the end of a chunk that holds several.
  const bool several_frames = frames && chunk[0] > 1;
  require(H5Pset_fill_time(list, several_frames ? H5D_FILL_TIME_ALLOC : H5D_FILL_TIME_NEVER) >= 0);
  if (level > 0) {
    require(H5Pset_shuffle(list) >= 0);
    require(H5Pset_deflate(list, static_cast<unsigned>(std::min(level, 9))) >= 0);  // HDF5 names zlib's levels
  }
  return Hdf5Dataset(require(H5Dcreate2(parent, name, type, space, H5P_DEFAULT, list, H5P_DEFAULT)));
}

void write_whole(hid_t dataset, hid_t type, const void* values) {
  require(H5Dwrite(dataset, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) >= 0);
}

Hdf5Type text_type(std::size_t size) {
  Hdf5Type type(require(H5Tcopy(H5T_C_S1)));
  require(H5Tset_size(type, size) >= 0 && H5Tset_cset(type, H5T_CSET_UTF8) >= 0 &&
          H5Tset_strpad(type, H5T_STR_NULLTERM) >= 0);
  return type;
}

// Strings of one length, that of the longest, with zeros behind: every reader takes them, and no heap is needed.
void write_text(hid_t parent, const char* name, std::span<const std::string> lines, const Dims& dims) {
  std::size_t width = 0;
  for (const std::string& line : lines) width = std::max(width, line.size());
  ++width;  // for the zero
  std::vector<char> bytes(width * lines.size());
  for (std::size_t k = 0; k < lines.size(); ++k) std::copy(lines[k].begin(), lines[k].end(), &bytes[k * width]);
  const Hdf5Type type = text_type(width);
  const Hdf5Dataset dataset = make_dataset(parent, name, type, dims);
  write_whole(dataset, type, bytes.data());
}

void write_attribute(hid_t object, const char* name, hid_t file_type, hid_t type, const void* value) {
  const Hdf5Space space(require(H5Screate(H5S_SCALAR)));
  const Hdf5Attribute attribute(require(H5Acreate2(object, name, file_type, space, H5P_DEFAULT, H5P_DEFAULT)));
  require(H5Awrite(attribute, type, value) >= 0);
}

// Soft, so that tools which list a file name a data set by its own place.
void soft_link(const char* path, hid_t group, const char* name) {
  require(H5Lcreate_soft(path, group, name, H5P_DEFAULT, H5P_DEFAULT) >= 0);
}

// Of fixed length too: strings of variable length lie in HDF5's global heap, and HDF5 1.10 does not return from some
// damaged heaps, so that our reader could not refuse them.
void write_attribute(hid_t object, const char* name, const std::string& value) {
  const Hdf5Type type = text_type(value.size() + 1);
  write_attribute(object, name, type, type, value.c_str());
}

void check(const CacheHeader& header, const CacheOptions& options) {
  const auto need = [](bool good, const char* what) {
    if (!good) throw std::invalid_argument(fmt::format("cache: {}", what));
  };
  need(header.offset.size() >= 2 && header.offset.front() == 0, "offset needs one strand or more and starts at 0");
  need(std::ranges::adjacent_find(header.offset, std::greater_equal()) == header.offset.end(), "offset must increase");
  need(header.offset.back() == header.rest_position.size(), "offset must end at the number of rest positions");
  const std::size_t strands = header.offset.size() - 1;
  need(header.region.size() == strands, "each strand needs a region");
  need(std::ranges::all_of(header.region, [&](std::uint32_t region) { return region < header.region_names.size(); }),
       "each region of a strand needs a name");
  need(header.root_uv.empty() || header.root_uv.size() == strands, "root_uv is for all strands or for none");
  need(std::isfinite(header.fps) && header.fps > 0, "fps must be above 0");
  need(options.deflate >= 0 && options.deflate <= 12, "deflate is 0 to 12");
  need(std::isfinite(options.precision) && options.precision >= 0, "precision must not be below 0");
  need(options.threads >= 1, "at least one thread");
}

// What keeps a .part from being gone on with.
void require_same(const CacheHeader& header, const CacheOptions& options, const CacheReader& old) {
  const CacheHeader& found = old.header();
  const auto expect = [](const std::string& what, const std::string& was, const std::string& is) {
    if (was != is) throw InputError(fmt::format("{} was {}, and is {} now", what, was, is));
  };
  const auto expect_names = [&](const char* kind, const auto& was, const auto& is) {
    for (std::size_t k = 0; k < std::min(was.size(), is.size()); ++k)
      expect(fmt::format("{} {}", kind, k + 1), was[k].first, is[k].first);
    expect(fmt::format("the number of {}s", kind), std::to_string(was.size()), std::to_string(is.size()));
  };
  expect("the version", found.program_version, header.program_version);
  expect_names("input", found.inputs, header.inputs);
  for (std::size_t k = 0; k < header.inputs.size(); ++k)
    if (found.inputs[k] != header.inputs[k])
      throw InputError(fmt::format("the input {} has changed", header.inputs[k].first));
  expect_names("parameter", found.parameters, header.parameters);
  for (std::size_t k = 0; k < header.parameters.size(); ++k)
    expect(header.parameters[k].first, found.parameters[k].second, header.parameters[k].second);
  const bool same_groom = found.offset == header.offset && found.region == header.region &&
                          found.region_names == header.region_names && found.root_uv == header.root_uv &&
                          found.rest_position == header.rest_position && found.colliders == header.colliders &&
                          found.fps == header.fps;
  const CacheOptions& stored = old.options();
  if (!same_groom || stored.precision != options.precision || stored.velocity != options.velocity ||
      stored.stats != options.stats || (stored.deflate == 0) != (options.deflate == 0))
    throw InputError("groom or cache settings were others");
  if (found.scene_text != header.scene_text) throw InputError("the text of the scene was another");
}

void sync_folder(const std::filesystem::path& file) {
  const std::filesystem::path folder = file.has_parent_path() ? file.parent_path() : ".";
  const int descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return;
  ::fsync(descriptor);  // some file systems cannot; the rename stands all the same
  ::close(descriptor);
}

}  // namespace

float round_to_precision(float v, double precision) {
  if (!(precision > 0)) return v;
  const double step = rounding_step(precision);
  return round_to_step(v, step, 1 / step);
}

struct CacheWriter::Impl {
  std::filesystem::path path;
  std::filesystem::path part;
  CacheOptions options;
  hsize_t strands;
  hsize_t vertices;
  hsize_t colliders;
  ChunkQueue queue;
  CommitFile disk;
  Hdf5File file;
  Hdf5Dataset position, velocity, head, collider, time, number, stretch, residual, penetration, substeps;
  hsize_t frames = 0;
  hsize_t kept = 0;  // frames that were there before
  const CacheFrame* begun = nullptr;
  std::string failure;  // why nothing more can be written

  Impl(const std::filesystem::path& final_path, std::filesystem::path part_path, const CacheHeader& header,
       const CacheOptions& cache_options, bool resume)
      : path(final_path),
        part(std::move(part_path)),
        options(cache_options),
        strands(header.region.size()),
        vertices(header.rest_position.size()),
        colliders(header.colliders),
        queue(vertices, options.deflate, options.threads, options.velocity,
              [this](const Vectors& vectors, std::size_t first, std::span<const std::uint8_t> bytes) {
                write_chunk(vectors, first, bytes);
              }),
        disk(part, resume) {}

  Dims chunk_dims(bool frame) const {
    const Dims dims = {1, queue.chunk_vertices(), 3};
    return frame ? dims : Dims(dims.begin() + 1, dims.end());
  }

  void create(const CacheHeader& header) {
    const Hdf5List creation(require(H5Pcreate(H5P_FILE_CREATE)));
    require(H5Pset_obj_track_times(creation, false) >= 0);
    const Hdf5List access = disk.access_list();
    file = Hdf5File(require(H5Fcreate(part.c_str(), H5F_ACC_TRUNC, creation, access)));

    const int version = kFormatVersion;
    const std::uint8_t complete = 0;
    write_attribute(file, "format", "strandbake");
    write_attribute(file, "format_version", H5T_STD_I32LE, H5T_NATIVE_INT, &version);
    write_attribute(file, "units", "m");
    write_attribute(file, "up", "+Y");
    write_attribute(file, "fps", H5T_IEEE_F64LE, H5T_NATIVE_DOUBLE, &header.fps);
    write_attribute(file, "complete", H5T_STD_U8LE, H5T_NATIVE_UINT8, &complete);

    const Hdf5Group strand_group = make_group(file, "strands");
    write_whole(make_dataset(strand_group, "offset", H5T_STD_U64LE, {strands + 1}), H5T_NATIVE_UINT64,
                header.offset.data());
    write_whole(make_dataset(strand_group, "region", H5T_STD_U32LE, {strands}), H5T_NATIVE_UINT32,
                header.region.data());
    if (!header.root_uv.empty())
      write_whole(make_dataset(strand_group, "root_uv", H5T_IEEE_F32LE, {strands, 2}), H5T_NATIVE_FLOAT,
                  header.root_uv.data());
    const Hdf5Group region_group = make_group(file, "regions");
    write_text(region_group, "name", header.region_names, {header.region_names.size()});

    const Hdf5Group rest_group = make_group(file, "rest");
    const Hdf5Dataset rest =
        make_dataset(rest_group, "position", H5T_IEEE_F32LE, {vertices, 3}, chunk_dims(false), options.deflate);
    queue.start({{rest, {}, header.rest_position, {}, 0}});
    write_chunks();
    write_provenance(header);

    if (options.stats) {
      const Hdf5Group stats = make_group(file, "stats");
      stretch = make_dataset(stats, "largest_stretch", H5T_IEEE_F32LE, {0}, {kSmallChunkFrames}, 0, true);
      residual = make_dataset(stats, "residual", H5T_IEEE_F32LE, {0}, {kSmallChunkFrames}, 0, true);
      penetration = make_dataset(stats, "deepest_penetration", H5T_IEEE_F32LE, {0}, {kSmallChunkFrames}, 0, true);
      substeps = make_dataset(stats, "substeps", H5T_STD_I32LE, {0}, {kSmallChunkFrames}, 0, true);
    }
    const Hdf5Group group = make_group(file, "frames");
    position =
        make_dataset(group, "position", H5T_IEEE_F32LE, {0, vertices, 3}, chunk_dims(true), options.deflate, true);
    write_attribute(position, "precision", H5T_IEEE_F64LE, H5T_NATIVE_DOUBLE, &options.precision);
    if (options.velocity)
      velocity =
          make_dataset(group, "velocity", H5T_IEEE_F32LE, {0, vertices, 3}, chunk_dims(true), options.deflate, true);
    head = make_dataset(group, "head", H5T_IEEE_F64LE, {0, 4, 4}, {kSmallChunkFrames, 4, 4}, 0, true);
    if (colliders > 0) {
      constexpr hsize_t kChunkColliders = 2048;
      const hsize_t chunk_frames = std::clamp<hsize_t>(kChunkColliders / colliders, 1, kSmallChunkFrames);
      collider =
          make_dataset(group, "collider", H5T_IEEE_F64LE, {0, colliders, 4}, {chunk_frames, colliders, 4}, 0, true);
    }
    time = make_dataset(group, "time", H5T_IEEE_F64LE, {0}, {kSmallChunkFrames}, 0, true);
    number = make_dataset(group, "number", H5T_STD_I32LE, {0}, {kSmallChunkFrames}, 0, true);
    flush();
  }

  void write_provenance(const CacheHeader& header) {
    const Hdf5Group group = make_group(file, "provenance");
    write_attribute(group, "version", header.program_version);
    write_text(group, "scene", std::span(&header.scene_text, 1), {});
    const auto write_pairs = [&](const char* name, const char* value_name,
                                 const std::vector<std::pair<std::string, std::string>>& pairs) {
      std::vector<std::string> names;
      std::vector<std::string> values;
      for (const auto& [key, value] : pairs) {
        names.push_back(key);
        values.push_back(value);
      }
      const Hdf5Group part_group = make_group(group, name);
      write_text(part_group, "name", names, {names.size()});
      write_text(part_group, value_name, values, {values.size()});
    };
    write_pairs("inputs", "sha256", header.inputs);
    write_pairs("parameters", "value", header.parameters);
  }

  // By whoever finds the chunk ready, one at a time.
  void write_chunk(const Vectors& vectors, std::size_t first, std::span<const std::uint8_t> bytes) {
    const QuietHdf5 quiet;
    if (first == 0 && vectors.frame) {
      const std::array<hsize_t, 3> dims = {*vectors.frame + 1, vertices, 3};
      require(H5Dset_extent(vectors.dataset, dims.data()) >= 0);
    }
    const std::array<hsize_t, 3> with_frame = {vectors.frame.value_or(0), first, 0};
    const hsize_t* const corner = with_frame.data() + (vectors.frame ? 0 : 1);
    require(H5Dwrite_chunk(vectors.dataset, H5P_DEFAULT, 0, corner, bytes.size(), bytes.data()) >= 0);
  }

  // What is left of them.
  void write_chunks() {
    if (!queue.done()) {
#pragma omp parallel num_threads(options.threads)
      queue.work(true);
    }
    queue.rethrow();
  }

  void append_small(hid_t dataset, hid_t type, const void* values, Dims dims = {1}) {
    const Hdf5Space memory(require(H5Screate_simple(static_cast<int>(dims.size()), dims.data(), nullptr)));
    Dims start(dims.size());
    start[0] = frames;
    Dims extent = dims;
    extent[0] = frames + 1;
    require(H5Dset_extent(dataset, extent.data()) >= 0);
    const Hdf5Space space(require(H5Dget_space(dataset)));
    require(H5Sselect_hyperslab(space, H5S_SELECT_SET, start.data(), nullptr, dims.data(), nullptr) >= 0);
    require(H5Dwrite(dataset, type, memory, space, H5P_DEFAULT, values) >= 0);
  }

  // What is flushed is committed as one step: see CommitFile.
  void flush() {
    require(H5Fflush(file, H5F_SCOPE_LOCAL) >= 0);
    require_disk();
  }

  void require_disk() const {
    if (disk.error() != 0) throw DiskError(std::generic_category().message(disk.error()));
  }

  void append(const CacheFrame& frame) {
    write_chunks();
    append_figures(frame);
  }

  void append_figures(const CacheFrame& frame) {
    if (options.stats) {
      append_small(stretch, H5T_NATIVE_FLOAT, &frame.stats.largest_stretch);
      append_small(residual, H5T_NATIVE_FLOAT, &frame.stats.residual);
      append_small(penetration, H5T_NATIVE_FLOAT, &frame.stats.deepest_penetration);
      append_small(substeps, H5T_NATIVE_INT32, &frame.stats.substeps);
    }
    const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> matrix = frame.head.matrix();
    append_small(head, H5T_NATIVE_DOUBLE, matrix.data(), {1, 4, 4});
    if (colliders > 0) append_small(collider, H5T_NATIVE_DOUBLE, frame.colliders.data(), {1, colliders, 4});
    append_small(time, H5T_NATIVE_DOUBLE, &frame.time);
    append_small(number, H5T_NATIVE_INT, &frame.number);
    flush();
    ++frames;
  }

  // Repeats what has led to the .part up to its last whole frame: see CommitFile::end_replay().
  void replay(const CacheHeader& header, const CacheReader& old) {
    create(header);
    disk.set_raw_is_there(true);
    std::vector<std::byte> any;
    const auto repeat = [&](hid_t dataset, CacheReader::Vectors which, std::size_t index) {
      const std::array<hsize_t, 3> dims = {index + 1, vertices, 3};
      require(H5Dset_extent(dataset, dims.data()) >= 0);
      for (std::size_t first = 0; first < vertices; first += queue.chunk_vertices()) {
        const std::array<hsize_t, 3> corner = {index, first, 0};
        const std::size_t size = old.packed_bytes(which, index, first);
        any.resize(std::max(any.size(), size));
        require(H5Dwrite_chunk(dataset, H5P_DEFAULT, 0, corner.data(), size, any.data()) >= 0);
      }
    };
    for (std::size_t index = 0; index < old.frame_count(); ++index) {
      repeat(position, CacheReader::Vectors::Position, index);
      if (options.velocity) repeat(velocity, CacheReader::Vectors::Velocity, index);
      CacheFrame frame;
      frame.number = old.frame_number(index);
      frame.time = old.frame_time(index);
      frame.head = old.head(index);
      frame.colliders = old.colliders(index);
      frame.stats = old.stats(index).value_or(FrameStats());
      append_figures(frame);
    }
    // Another HDF5 might lay a file out in another way.
    if (frames > 0) {
      for (std::size_t first = 0; first < vertices; first += queue.chunk_vertices()) {
        const std::array<hsize_t, 3> corner = {frames - 1, first, 0};
        const std::vector<std::byte> there = old.read_packed(CacheReader::Vectors::Position, frames - 1, first);
        std::uint32_t skipped = 0;
        any.resize(std::max(any.size(), there.size()));
        if (H5Dread_chunk(position, H5P_DEFAULT, corner.data(), &skipped, any.data()) < 0 ||
            !std::equal(there.begin(), there.end(), any.begin()))
          throw InputError("it was not laid out by this program");
      }
    }
    disk.end_replay();
    require_disk();
    kept = frames;
  }

  void close_file() {
    for (Hdf5Dataset* dataset :
         {&position, &velocity, &head, &collider, &time, &number, &stretch, &residual, &penetration, &substeps})
      dataset->close();
    require(file.close());
    disk.sync();
    require_disk();
  }

  // Leaves the file as the last commit has it, which must be on the device all the same.
  void drop() {
    disk.sync();
    const QuietHdf5 quiet;
    disk.abandon();
    failure = fmt::format("{}: was closed in the middle of a frame", part.string());
  }

  // The cache once more as a PolyData with time steps, as VTK's HDF5 format 2.0 has it: links to our data sets, vectors
  // of all frames in one row as virtual data sets over ours, and the little that is new. Done when the number of frames
  // is known, as a virtual data set cannot grow with two dimensions of another.
  void write_vtk_view() {
    if (frames == 0) return;
    require(H5Fset_libver_bounds(file, H5F_LIBVER_V18, H5F_LIBVER_V110) >= 0);  // 1.8 has no virtual data sets
    const Hdf5Group view = make_group(file, "VTKHDF");
    {
      const std::array<std::int64_t, 2> version = {2, 0};
      const hsize_t two = 2;
      const Hdf5Space space(require(H5Screate_simple(1, &two, nullptr)));
      const Hdf5Attribute attribute(
          require(H5Acreate2(view, "Version", H5T_STD_I64LE, space, H5P_DEFAULT, H5P_DEFAULT)));
      require(H5Awrite(attribute, H5T_NATIVE_INT64, version.data()) >= 0);
      const Hdf5Type text(require(H5Tcopy(H5T_C_S1)));  // VTK takes no UTF-8 here
      require(H5Tset_size(text, 8) >= 0 && H5Tset_strpad(text, H5T_STR_NULLPAD) >= 0);
      write_attribute(view, "Type", text, text, "PolyData");
    }
    const auto write_integers = [](hid_t group, const char* name, const std::vector<std::int64_t>& values,
                                   const Dims& dims) {
      write_whole(make_dataset(group, name, H5T_STD_I64LE, dims), H5T_NATIVE_INT64, values.data());
    };
    const auto write_integer = [&](hid_t group, const char* name, hsize_t value) {
      write_integers(group, name, {static_cast<std::int64_t>(value)}, {1});
    };
    write_integer(view, "NumberOfPoints", vertices);
    const Dims one_row = {frames * vertices, 3};
    const Dims by_frame = {frames, vertices, 3};
    make_virtual(view, "Points", H5T_IEEE_F32LE, one_row, "/frames/position", by_frame);

    const Hdf5Group lines = make_group(view, "Lines");
    write_integer(lines, "NumberOfCells", strands);
    write_integer(lines, "NumberOfConnectivityIds", vertices);
    // VTK 9.3 wants the type of numbers that Connectivity has.
    make_virtual(lines, "Offsets", H5T_STD_I64LE, {strands + 1}, "/strands/offset", {strands + 1});
    {
      std::vector<std::int64_t> connectivity(vertices);  // packs 200 : 1
      std::iota(connectivity.begin(), connectivity.end(), std::int64_t{0});
      const Hdf5Dataset dataset = make_dataset(lines, "Connectivity", H5T_STD_I64LE, {vertices},
                                               {std::min<hsize_t>(vertices, kChunkVertices)}, 1);
      write_whole(dataset, H5T_NATIVE_INT64, connectivity.data());
    }
    const Hdf5Group vertex_cells = make_group(view, "Vertices");  // none, and no polygons and strips either
    write_integer(vertex_cells, "NumberOfCells", 0);
    write_integer(vertex_cells, "NumberOfConnectivityIds", 0);
    write_integer(vertex_cells, "Offsets", 0);
    write_integers(vertex_cells, "Connectivity", {}, {0});
    for (const char* const name : {"Polygons", "Strips"}) soft_link("Vertices", view, name);

    const Hdf5Group cell_data = make_group(view, "CellData");
    soft_link("/strands/region", cell_data, "region");

    const Hdf5Group steps = make_group(view, "Steps");
    const auto count = static_cast<std::int64_t>(frames);
    write_attribute(steps, "NSteps", H5T_STD_I64LE, H5T_NATIVE_INT64, &count);
    soft_link("/frames/time", steps, "Values");
    const std::vector<std::int64_t> zeros(4 * frames);
    std::vector<std::int64_t> first_points(frames);
    for (std::size_t frame = 0; frame < frames; ++frame)
      first_points[frame] = static_cast<std::int64_t>(frame * vertices);
    write_integers(steps, "PointOffsets", first_points, {frames});
    write_integers(steps, "PartOffsets", zeros, {frames});
    write_integers(steps, "NumberOfParts", std::vector<std::int64_t>(frames, 1), {frames});
    write_integers(steps, "CellOffsets", zeros, {frames, 4});  // of vertices, lines, polygons, strips
    soft_link("CellOffsets", steps, "ConnectivityIdOffsets");
    const Hdf5Group cell_offsets = make_group(steps, "CellDataOffsets");
    soft_link("/VTKHDF/Steps/PartOffsets", cell_offsets, "region");
    if (options.velocity) {
      const Hdf5Group point_data = make_group(view, "PointData");
      make_virtual(point_data, "velocity", H5T_IEEE_F32LE, one_row, "/frames/velocity", by_frame);
      const Hdf5Group point_offsets = make_group(steps, "PointDataOffsets");
      soft_link("/VTKHDF/Steps/PointOffsets", point_offsets, "velocity");
    }
    flush();
  }

  // Shows all values of `source`, in their order, as another shape and type of numbers.
  static void make_virtual(hid_t group, const char* name, hid_t type, const Dims& dims, const char* source,
                           const Dims& source_dims) {
    const Hdf5Space space(require(H5Screate_simple(static_cast<int>(dims.size()), dims.data(), nullptr)));
    const Hdf5Space source_space(
        require(H5Screate_simple(static_cast<int>(source_dims.size()), source_dims.data(), nullptr)));
    const Hdf5List list(require(H5Pcreate(H5P_DATASET_CREATE)));
    require(H5Pset_obj_track_times(list, false) >= 0);
    require(H5Pset_virtual(list, space, ".", source, source_space) >= 0);
    const Hdf5Dataset dataset(require(H5Dcreate2(group, name, type, space, H5P_DEFAULT, list, H5P_DEFAULT)));
  }

  void mark_complete() {
    disk.sync();  // the mark must not reach the device before what it vouches for
    require_disk();
    const std::uint8_t complete = 1;
    const Hdf5Attribute attribute(require(H5Aopen(file, "complete", H5P_DEFAULT)));
    require(H5Awrite(attribute, H5T_NATIVE_UINT8, &complete) >= 0);
  }

  bool open() const {
    return file >= 0;
  }

  // Nobody would find what is written to a file without a name, and under that name there may be another.
  void require_name() {
    if (disk.is_named(part)) return;
    disk.abandon();
    failure = fmt::format("{}: was removed or replaced while it was written; bake again", part.string());
    throw DiskError(failure);
  }

  // Runs a step that writes. Whatever goes wrong, nothing of the step reaches the file, and nothing after it.
  template <class Step>
  void attempt(const std::string& deed, Step step) {
    if (!failure.empty()) throw DiskError(failure);
    const QuietHdf5 quiet;
    try {
      step();
    } catch (const DiskError& error) {
      disk.abandon();
      failure =
          fmt::format("{}: cannot {}: {}; free some space or choose another disk", part.string(), deed, error.what());
      throw DiskError(failure);
    } catch (...) {
      disk.abandon();
      failure = fmt::format("{}: cannot {}", part.string(), deed);
      throw;
    }
  }
};

bool has_begun(const std::filesystem::path& path) {
  std::filesystem::path part = path;
  part += ".part";
  std::array<char, 4> start = {};
  std::ifstream file(part, std::ios::binary);
  return file.read(start.data(), start.size()) && start != std::array<char, 4>{};
}

CacheWriter::CacheWriter(const std::filesystem::path& path, const CacheHeader& header, const CacheOptions& options,
                         Existing existing) {
  check(header, options);
  std::error_code ignored;
  if (std::filesystem::is_directory(path, ignored) || !path.has_filename())
    throw DiskError(fmt::format("{}: is a folder; name a file", path.string()));
  if (path.has_parent_path() && !std::filesystem::exists(path.parent_path(), ignored))
    throw DiskError(fmt::format("{}: there is no folder {}; create it", path.string(), path.parent_path().string()));
  std::filesystem::path part = path;
  part += ".part";
  const bool resume = existing == Existing::Resume && has_begun(path);
  impl_ = std::make_unique<Impl>(path, part, header, options, resume);
  if (resume) {
    try {
      const CacheReader old(part);
      require_same(header, options, old);
      impl_->attempt("be gone on with", [&] { impl_->replay(header, old); });
    } catch (const InputError& error) {
      const std::string name = part.string() + ": ";
      const std::string what = error.what();
      impl_->disk.abandon();
      const QuietHdf5 quiet;
      impl_.reset();
      throw InputError(fmt::format("{}cannot be resumed: {}; without --resume, --force starts anew", name,
                                   what.starts_with(name) ? what.substr(name.size()) : what));
    } catch (...) {
      const QuietHdf5 quiet;
      impl_.reset();
      throw;
    }
    return;
  }
  try {
    impl_->attempt("be created", [&] { impl_->create(header); });
  } catch (...) {
    std::filesystem::remove(part, ignored);  // without a frame it is of no use
    const QuietHdf5 quiet;
    impl_.reset();
    throw;
  }
}

CacheWriter::~CacheWriter() {
  if (impl_ == nullptr || !impl_->open()) return;
  if (impl_->frames == 0 && impl_->failure.empty()) {
    impl_->disk.abandon();
    std::error_code ignored;
    std::filesystem::remove(impl_->part, ignored);  // without a frame it is of no use
  } else {
    try {
      close();
    } catch (...) {
      // Who wants to know calls close().
    }
  }
  const QuietHdf5 quiet;
  impl_.reset();
}

std::size_t CacheWriter::frame_count() const {
  return impl_->frames;
}

void CacheWriter::begin(const CacheFrame& frame) {
  if (!impl_->failure.empty()) throw DiskError(impl_->failure);
  if (!impl_->open()) throw std::logic_error("cache: a frame after finish() or close()");
  impl_->require_name();
  if (impl_->begun != nullptr) throw std::logic_error("cache: a frame before the last one was ended");
  if (frame.position.size() != impl_->vertices)
    throw std::invalid_argument("cache: a position for each vertex is needed");
  if (static_cast<bool>(frame.velocity) != impl_->options.velocity)
    throw std::invalid_argument("cache: velocities are needed where the cache has them, and only there");
  if (frame.colliders.size() != impl_->colliders)
    throw std::invalid_argument("cache: as many colliders are needed as the header says");
  std::vector<Vectors> vectors = {{impl_->position, impl_->frames, frame.position, {}, impl_->options.precision}};
  if (frame.velocity) vectors.push_back({impl_->velocity, impl_->frames, {}, frame.velocity, 0});
  impl_->queue.start(std::move(vectors));
  impl_->begun = &frame;
}

void CacheWriter::work(bool may_wait) {
  if (impl_->begun != nullptr) impl_->queue.work(may_wait);
}

void CacheWriter::end() {
  if (impl_->begun == nullptr) throw std::logic_error("cache: a frame is ended that was not begun");
  const CacheFrame& frame = *std::exchange(impl_->begun, nullptr);
  impl_->attempt(fmt::format("write frame {}", frame.number), [&] { impl_->append(frame); });
}

void CacheWriter::close() {
  if (!impl_->failure.empty() || !impl_->open()) return;  // a failure has been told
  if (impl_->begun != nullptr) {
    impl_->begun = nullptr;
    impl_->drop();
    return;
  }
  if (impl_->kept > 0 && impl_->frames == impl_->kept) {  // it may be finished but for its name: leave it so
    const QuietHdf5 quiet;
    impl_->disk.abandon();
    impl_->failure = fmt::format("{}: was closed", impl_->part.string());
    return;
  }
  impl_->attempt("be closed", [&] { impl_->close_file(); });
}

void CacheWriter::finish() {
  if (!impl_->failure.empty()) throw DiskError(impl_->failure);
  if (!impl_->open()) throw std::logic_error("cache: finish() after finish() or close()");
  if (impl_->begun != nullptr) throw std::logic_error("cache: finish() before the last frame was ended");
  impl_->require_name();
  impl_->attempt("be finished", [&] {
    impl_->write_vtk_view();
    impl_->mark_complete();
    impl_->close_file();
  });
  if (::rename(impl_->part.c_str(), impl_->path.c_str()) != 0) {
    impl_->failure = fmt::format("{}: cannot be renamed to {}: {}; rename it yourself, it is complete",
                                 impl_->part.string(), impl_->path.string(), std::generic_category().message(errno));
    throw DiskError(impl_->failure);
  }
  sync_folder(impl_->path);
}

}  // namespace strandbake
