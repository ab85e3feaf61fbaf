#include "formats/cache.h"

#include <hdf5.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <catch2/catch.hpp>
#include <cmath>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <new>
#include <random>
#include <stdexcept>
#include <thread>

#include "formats/digest.h"
#include "tests/formats/cache_sample.h"

using namespace strandbake;
namespace fs = std::filesystem;

namespace {

// A folder of its own for each test, gone afterwards.
struct Folder {
  fs::path path;
  Folder() {
    std::string name = (fs::temp_directory_path() / "strandbake_cache_XXXXXX").string();
    REQUIRE(::mkdtemp(name.data()) != nullptr);
    path = name;
  }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
  fs::path operator/(const std::string& name) const { return path / name; }
};

void write_sample(const fs::path& path, const CacheHeader& header, const CacheOptions& options, int first, int last) {
  CacheWriter writer(path, header, options);
  for (int number = first; number <= last; ++number) writer.write(SampleFrame(header, options, number).frame);
  writer.finish();
}

bool same_bits(std::span<const Eigen::Vector3f> a, std::span<const Eigen::Vector3f> b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size_bytes()) == 0;
}

void check_frames(const CacheReader& reader, const CacheHeader& header, const CacheOptions& options, int first,
                  int last) {
  REQUIRE(reader.frame_count() == static_cast<std::size_t>(last - first + 1));
  REQUIRE(reader.vertex_count() == header.rest_position.size());
  std::vector<Eigen::Vector3f> vectors(reader.vertex_count());
  for (std::size_t index = 0; index < reader.frame_count(); ++index) {
    SampleFrame sample(header, options, first + static_cast<int>(index));
    for (Eigen::Vector3f& position : sample.position)
      for (float& x : position) x = round_to_precision(x, options.precision);
    CHECK(reader.frame_number(index) == sample.frame.number);
    CHECK(reader.frame_time(index) == sample.frame.time);
    CHECK(reader.head(index).matrix() == sample.frame.head.matrix());
    const auto colliders = reader.colliders(index);
    REQUIRE(colliders.size() == sample.colliders.size());
    for (std::size_t c = 0; c < colliders.size(); ++c) {
      CHECK(colliders[c].center == sample.colliders[c].center);
      CHECK(colliders[c].radius == sample.colliders[c].radius);
    }
    REQUIRE(reader.stats(index).has_value() == options.stats);
    if (options.stats) {
      CHECK(reader.stats(index)->largest_stretch == sample.frame.stats.largest_stretch);
      CHECK(reader.stats(index)->residual == sample.frame.stats.residual);
      CHECK(reader.stats(index)->deepest_penetration == sample.frame.stats.deepest_penetration);
      CHECK(reader.stats(index)->substeps == sample.frame.stats.substeps);
    }
    reader.read_position(index, vectors);
    CHECK(same_bits(vectors, sample.position));
    REQUIRE(reader.has_velocity() == options.velocity);
    if (options.velocity) {
      reader.read_velocity(index, vectors);
      CHECK(same_bits(vectors, sample.velocity));
    }
  }
}

void check_header(const CacheHeader& found, const CacheHeader& expected) {
  CHECK(found.fps == expected.fps);
  CHECK(found.offset == expected.offset);
  CHECK(found.region == expected.region);
  CHECK(found.region_names == expected.region_names);
  CHECK(found.root_uv == expected.root_uv);
  CHECK(same_bits(found.rest_position, expected.rest_position));
  CHECK(found.colliders == expected.colliders);
  CHECK(found.program_version == expected.program_version);
  CHECK(found.scene_text == expected.scene_text);
  CHECK(found.inputs == expected.inputs);
  CHECK(found.parameters == expected.parameters);
}

std::string message_of(const fs::path& path) {
  try {
    const CacheReader reader(path);
  } catch (const InputError& error) {
    return error.what();
  }
  return "read without a complaint";
}

// Opens a finished cache with HDF5 itself and changes it.
void alter(const fs::path& path, const std::function<void(hid_t)>& change) {
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  REQUIRE(file >= 0);
  change(file);
  REQUIRE(H5Fclose(file) >= 0);
}

template <class T>
void alter_value(hid_t file, const char* name, hid_t type, hsize_t index, T value) {
  const hid_t set = H5Dopen2(file, name, H5P_DEFAULT);
  const hid_t space = H5Dget_space(set);
  const hid_t memory = H5Screate(H5S_SCALAR);
  REQUIRE(H5Sselect_elements(space, H5S_SELECT_SET, 1, &index) >= 0);
  REQUIRE(H5Dwrite(set, type, memory, space, H5P_DEFAULT, &value) >= 0);
  H5Sclose(memory);
  H5Sclose(space);
  H5Dclose(set);
}

template <class T>
void alter_attribute(hid_t object, const char* name, hid_t type, T value) {
  const hid_t attribute = H5Aopen(object, name, H5P_DEFAULT);
  REQUIRE(H5Awrite(attribute, type, &value) >= 0);
  H5Aclose(attribute);
}

// Zeros of the new shape; a claim too large to fill is left without bytes.
void replace_dataset(hid_t file, const char* name, hid_t type, std::vector<hsize_t> dims) {
  REQUIRE(H5Ldelete(file, name, H5P_DEFAULT) >= 0);
  const hid_t space = H5Screate_simple(static_cast<int>(dims.size()), dims.data(), nullptr);
  const hid_t list = H5Pcreate(H5P_DATASET_CREATE);
  H5Pset_alloc_time(list, dims[0] < 1000000 ? H5D_ALLOC_TIME_EARLY : H5D_ALLOC_TIME_LATE);
  const hid_t set = H5Dcreate2(file, name, type, space, H5P_DEFAULT, list, H5P_DEFAULT);
  REQUIRE(set >= 0);
  H5Dclose(set);
  H5Pclose(list);
  H5Sclose(space);
}

void set_extent(hid_t file, const char* name, std::vector<hsize_t> dims) {
  const hid_t set = H5Dopen2(file, name, H5P_DEFAULT);
  REQUIRE(H5Dset_extent(set, dims.data()) >= 0);
  H5Dclose(set);
}

// While it lives, no file grows beyond this size: what a full disk does, without a disk.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) {
    old_action_ = std::signal(SIGXFSZ, SIG_IGN);
    ::getrlimit(RLIMIT_FSIZE, &old_);
    const rlimit limit = {bytes, old_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~FileSizeLimit() {
    ::setrlimit(RLIMIT_FSIZE, &old_);
    std::signal(SIGXFSZ, old_action_);
  }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;

 private:
  rlimit old_ = {};
  void (*old_action_)(int) = nullptr;
};

}  // namespace

TEST_CASE("a cache gives back what was written, with every combination of options") {
  const Folder folder;
  const CacheHeader header = sample_header(40);
  for (const int deflate : {0, 1, 6, 12})
    for (const double precision : {0.0, 1e-5})
      for (const bool velocity : {false, true})
        for (const bool stats : {false, true}) {
          CAPTURE(deflate, precision, velocity, stats);
          const CacheOptions options = {deflate, precision, velocity, stats, 2};
          write_sample(folder / "a.h5", header, options, -1, 3);
          const CacheReader reader(folder / "a.h5");
          check_header(reader.header(), header);
          check_frames(reader, header, options, -1, 3);
          CHECK(reader.complete());
          CHECK(reader.options().deflate == std::min(deflate, 9));
          CHECK(reader.options().precision == precision);
          CHECK(reader.stored_bytes() > 0);
          CHECK_FALSE(fs::exists(folder / "a.h5.part"));
        }
}

TEST_CASE("a cache of one strand, of full and of partly filled chunks reads back") {
  const Folder folder;
  for (const std::size_t vertices : {2, 16383, 16384, 16385, 40001}) {
    CAPTURE(vertices);
    CacheHeader header = sample_header(1);
    header.offset = {0, vertices};
    header.rest_position.resize(vertices);
    for (std::size_t k = 0; k < vertices; ++k)
      header.rest_position[k] = Eigen::Vector3f::Constant(static_cast<float>(k));
    for (const int deflate : {0, 1}) {
      const CacheOptions options = {.deflate = deflate, .threads = 3};
      write_sample(folder / "a.h5", header, options, 1, 2);
      check_frames(CacheReader(folder / "a.h5"), header, options, 1, 2);
    }
  }
}

TEST_CASE("what a header may leave out may be left out") {
  const Folder folder;
  CacheHeader header = sample_header(3);
  header.root_uv.clear();
  header.scene_text.clear();
  header.program_version.clear();
  header.inputs.clear();
  header.parameters.clear();
  write_sample(folder / "a.h5", header, {}, 1, 0);
  const CacheReader reader(folder / "a.h5");
  check_header(reader.header(), header);
  CHECK(reader.frame_count() == 0);
  CHECK(reader.complete());
}

TEST_CASE("the frames of many chunks of the small data sets read back") {
  const Folder folder;
  const CacheHeader header = sample_header(1);
  write_sample(folder / "a.h5", header, {}, 1, 200);
  check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 200);
}

TEST_CASE("the bytes of a cache depend neither on the threads nor on the run") {
  const Folder folder;
  const CacheHeader header = sample_header(8000);  // 64,000 vertices in four chunks
  for (const int deflate : {0, 1}) {
    std::string digest;
    for (const int threads : {1, 2, 3, 7, 1}) {
      CAPTURE(deflate, threads);
      write_sample(folder / "a.h5", header, {deflate, 1e-5, true, true, threads}, 1, 3);
      const std::string found = sha256_file(folder / "a.h5");
      if (digest.empty()) digest = found;
      CHECK(found == digest);
    }
  }
}

TEST_CASE("a frame that any number of threads write has the same bytes") {
  const Folder folder;
  const CacheHeader header = sample_header(8000);
  for (const int deflate : {0, 1})
    for (const double precision : {0.0, 1e-5}) {
      const CacheOptions options = {deflate, precision, true, true, 3};
      write_sample(folder / "a.h5", header, options, 1, 4);
      const std::string digest = sha256_file(folder / "a.h5");
      for (const int threads : {1, 2, 3, 7}) {  // more than the options have room for, too
        CAPTURE(deflate, precision, threads);
        CacheWriter writer(folder / "b.h5", header, options);
        for (int number = 1; number <= 4; ++number) {
          const SampleFrame sample(header, options, number);
          writer.begin(sample.frame);
          std::vector<std::thread> workers;
          for (int thread = 0; thread < threads; ++thread)
            workers.emplace_back([&writer, thread] { writer.work(thread % 2 == 1); });
          for (std::thread& worker : workers) worker.join();
          writer.end();
        }
        writer.finish();
        CHECK(sha256_file(folder / "b.h5") == digest);
      }
    }
}

TEST_CASE("work without a frame does nothing, and frames do not overlap") {
  const Folder folder;
  const CacheHeader header = sample_header(3);
  const SampleFrame sample(header, {}, 1);
  CacheWriter writer(folder / "a.h5", header, {});
  writer.work(true);
  CHECK_THROWS_AS(writer.end(), std::logic_error);
  writer.begin(sample.frame);
  CHECK_THROWS_AS(writer.begin(sample.frame), std::logic_error);
  CHECK_THROWS_AS(writer.finish(), std::logic_error);
  writer.end();
  writer.work(true);
  writer.finish();
  check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 1);
}

TEST_CASE("a frame that was begun and not ended is dropped") {
  const Folder folder;
  const CacheHeader header = sample_header(8000);
  const bool closes = GENERATE(true, false);
  {
    CacheWriter writer(folder / "a.h5", header, {});
    writer.write(SampleFrame(header, {}, 1).frame);
    {
      const SampleFrame sample(header, {}, 2);
      writer.begin(sample.frame);
      writer.work(true);
    }
    if (closes) {
      writer.close();
      CHECK_THROWS_AS(writer.finish(), DiskError);
    }
  }
  check_frames(CacheReader(folder / "a.h5.part"), header, {}, 1, 1);
}

TEST_CASE("what goes wrong in a thread is told at the end of the frame, and the frames before it stay") {
  const Folder folder;
  const CacheHeader header = sample_header(8000);
  const CacheOptions options = {.velocity = true, .threads = 3};
  CacheWriter writer(folder / "a.h5", header, options);
  writer.write(SampleFrame(header, options, 1).frame);
  SampleFrame sample(header, options, 2);
  sample.frame.velocity = [](std::size_t first, std::span<Eigen::Vector3f>) {
    if (first > 0) throw std::bad_alloc();
  };
  writer.begin(sample.frame);
  std::vector<std::thread> workers;
  for (int thread = 0; thread < 3; ++thread) workers.emplace_back([&writer] { writer.work(true); });
  for (std::thread& worker : workers) worker.join();
  CHECK_THROWS_AS(writer.end(), std::bad_alloc);
  CHECK_THROWS_WITH(writer.begin(sample.frame), Catch::Contains("cannot write frame 2"));
  writer.close();
  check_frames(CacheReader(folder / "a.h5.part"), header, options, 1, 1);
}

TEST_CASE("rounding to a precision stays within its bound") {
  std::mt19937 random(7);
  for (const double precision : {1e-5, 1e-4, 1e-3, 0.25, 1e-7, 3e-2}) {
    for (int k = 0; k < 200000; ++k) {
      // Magnitudes from 1e-12 to 1e12, evenly in the exponent.
      const float v = std::bit_cast<float>(static_cast<std::uint32_t>(random() % 0x28000000U + 0x2b800000U)) *
                      (k % 2 == 0 ? 1.0F : -1.0F);
      const float rounded = round_to_precision(v, precision);
      const double error = std::abs(static_cast<double>(rounded) - static_cast<double>(v));
      if (!(error <= precision / 2)) FAIL("value " << v << " became " << rounded << " at precision " << precision);
      if (round_to_precision(rounded, precision) != rounded) FAIL("value " << v << " moves when rounded again");
    }
  }
}

TEST_CASE("rounding to a precision goes to multiples of the power of two below it") {
  CHECK(round_to_precision(0.5F, 1.0) == 0.0F);
  CHECK(round_to_precision(1.5F, 1.0) == 2.0F);
  CHECK(round_to_precision(2.5F, 1.0) == 2.0F);
  CHECK(round_to_precision(2.5F, 1.999) == 2.0F);
  CHECK(round_to_precision(3.5F, 2.0) == 4.0F);
  CHECK(round_to_precision(-2.5F, 1.0) == -2.0F);
  CHECK(round_to_precision(0.3F, 0.3) == 0.25F);
  CHECK(std::fmod(round_to_precision(1.2345F, 1e-5), 0x1p-17F) == 0.0F);
  CHECK_FALSE(std::signbit(round_to_precision(-0.1F, 1.0)));
  CHECK_FALSE(std::signbit(round_to_precision(-0.0F, 1.0)));
}

TEST_CASE("what cannot be rounded to a precision stays as it is") {
  constexpr float kLargest = std::numeric_limits<float>::max();
  CHECK(round_to_precision(0.1F, 0.0) == 0.1F);
  CHECK(round_to_precision(kLargest, 1e-5) == kLargest);
  CHECK(round_to_precision(-kLargest, 1e38) == -kLargest);  // the nearest multiple, -2^128, is no float
  CHECK(round_to_precision(kLargest, 1e300) == 0.0F);
  CHECK(round_to_precision(1e20F, std::numeric_limits<double>::denorm_min()) == 1e20F);
  CHECK(round_to_precision(INFINITY, 1e-5) == INFINITY);
  CHECK(std::isnan(round_to_precision(NAN, 1e-5)));
}

TEST_CASE("precision makes a cache smaller") {
  const Folder folder;
  const CacheHeader header = sample_header(1000);
  write_sample(folder / "exact.h5", header, {.precision = 0}, 1, 3);
  write_sample(folder / "rounded.h5", header, {.precision = 1e-4}, 1, 3);
  CHECK(CacheReader(folder / "rounded.h5").stored_bytes() < CacheReader(folder / "exact.h5").stored_bytes() * 3 / 4);
}

TEST_CASE("a cache left without finish stays as a readable .part, which the next one overwrites") {
  const Folder folder;
  const CacheHeader header = sample_header(20);
  const CacheOptions options;
  {
    CacheWriter writer(folder / "a.h5", header, options);
    for (int number = 1; number <= 3; ++number) writer.write(SampleFrame(header, options, number).frame);
    // In progress: another reader may look.
    const CacheReader reader(folder / "a.h5.part");
    CHECK_FALSE(reader.complete());
    check_frames(reader, header, options, 1, 3);
  }
  CHECK_FALSE(fs::exists(folder / "a.h5"));
  {
    const CacheReader reader(folder / "a.h5.part");
    CHECK_FALSE(reader.complete());
    check_header(reader.header(), header);
    check_frames(reader, header, options, 1, 3);
  }
  write_sample(folder / "a.h5", header, options, 5, 6);
  check_frames(CacheReader(folder / "a.h5"), header, options, 5, 6);
}

TEST_CASE("close leaves a readable .part and ends the writing") {
  const Folder folder;
  const CacheHeader header = sample_header(2);
  CacheWriter writer(folder / "a.h5", header, {});
  writer.write(SampleFrame(header, {}, 1).frame);
  writer.close();
  writer.close();
  check_frames(CacheReader(folder / "a.h5.part"), header, {}, 1, 1);
  CHECK_THROWS_AS(writer.write(SampleFrame(header, {}, 2).frame), std::logic_error);
  CHECK_THROWS_AS(writer.finish(), std::logic_error);
}

TEST_CASE("a cache that is given up before its first frame leaves nothing, unless it was closed") {
  const Folder folder;
  const CacheHeader header = sample_header(2);
  { const CacheWriter writer(folder / "a.h5", header, {}); }
  CHECK(fs::is_empty(folder.path));
  CacheWriter(folder / "a.h5", header, {}).close();
  check_frames(CacheReader(folder / "a.h5.part"), header, {}, 1, 0);
}

TEST_CASE("nothing can be written after finish") {
  const Folder folder;
  const CacheHeader header = sample_header(2);
  CacheWriter writer(folder / "a.h5", header, {});
  writer.finish();
  writer.close();
  CHECK_THROWS_AS(writer.write(SampleFrame(header, {}, 2).frame), std::logic_error);
  CHECK_THROWS_AS(writer.finish(), std::logic_error);
}

TEST_CASE("a bake killed after any number of frames leaves those frames") {
  const Folder folder;
  const CacheHeader header = sample_header(300);
  for (const CacheOptions& options : {CacheOptions{.deflate = 0}, CacheOptions{.deflate = 1, .velocity = true}})
    for (const int frames : {0, 1, 31, 32, 33, 65, 150}) {
      CAPTURE(options.deflate, frames);
      const pid_t child = ::fork();
      REQUIRE(child >= 0);
      if (child == 0) {
        try {
          CacheWriter writer(folder / "a.h5", header, options);
          for (int number = 1; number <= frames; ++number) writer.write(SampleFrame(header, options, number).frame);
          ::raise(SIGKILL);
        } catch (...) {
        }
        ::_exit(1);
      }
      int status = 0;
      REQUIRE(::waitpid(child, &status, 0) == child);
      REQUIRE(WIFSIGNALED(status));
      check_frames(CacheReader(folder / "a.h5.part"), header, options, 1, frames);
    }
}

TEST_CASE("a cache cut at any length is refused") {
  const Folder folder;
  const CacheHeader header = sample_header(12);
  write_sample(folder / "a.h5", header, {.deflate = 1, .velocity = true}, 1, 2);
  const auto size = fs::file_size(folder / "a.h5");
  const std::uintmax_t step = std::max<std::uintmax_t>(size / 400, 1);
  for (std::uintmax_t length = size - 1; length > 0; length -= std::min(length, length > 600 ? step : 1)) {
    fs::resize_file(folder / "a.h5", length);
    CAPTURE(length);
    CHECK_THROWS_AS(CacheReader(folder / "a.h5"), InputError);
  }
  fs::resize_file(folder / "a.h5", 0);
  CHECK_THAT(message_of(folder / "a.h5"), Catch::Contains("is not an HDF5 file"));
}

TEST_CASE("what is not a cache is refused with its name and the reason") {
  const Folder folder;
  CHECK_THAT(message_of(folder / "none.h5"), Catch::Contains("none.h5: there is no such file"));
  CHECK_THAT(message_of(folder.path), Catch::Contains("is a folder"));
  CHECK_THAT(message_of("/dev/null"), Catch::Contains("is not a regular file"));
  std::ofstream(folder / "text.h5") << "not a cache at all\n";
  CHECK_THAT(message_of(folder / "text.h5"), Catch::Contains("text.h5: is not an HDF5 file"));
  const hid_t file = H5Fcreate((folder / "foreign.h5").c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  H5Fclose(file);
  CHECK_THAT(message_of(folder / "foreign.h5"), Catch::Contains("but not a Strandbake cache"));
}

TEST_CASE("a cache of a newer format version is refused with the version") {
  const Folder folder;
  write_sample(folder / "a.h5", sample_header(2), {}, 1, 1);
  alter(folder / "a.h5", [](hid_t file) { alter_attribute(file, "format_version", H5T_NATIVE_INT, 2); });
  CHECK_THAT(message_of(folder / "a.h5"), Catch::Contains("version 2") && Catch::Contains("newer Strandbake"));
  alter(folder / "a.h5", [](hid_t file) { alter_attribute(file, "format_version", H5T_NATIVE_INT, 0); });
  CHECK_THAT(message_of(folder / "a.h5"), Catch::Contains("version 0"));
}

TEST_CASE("a cache whose parts disagree is refused with the part") {
  const Folder folder;
  const CacheHeader header = sample_header(5);
  const hsize_t vertices = header.rest_position.size();
  struct Lie {
    std::string message;
    std::function<void(hid_t)> change;
  };
  const std::vector<Lie> lies = {
      {"/strands/offset starts at 1",
       [](hid_t file) { alter_value<std::uint64_t>(file, "/strands/offset", H5T_NATIVE_UINT64, 0, 1); }},
      {"/strands/offset does not increase at strand 1",
       [](hid_t file) { alter_value<std::uint64_t>(file, "/strands/offset", H5T_NATIVE_UINT64, 2, 1); }},
      {"/strands/offset does not increase",
       [](hid_t file) { alter_value(file, "/strands/offset", H5T_NATIVE_UINT64, 1, ~std::uint64_t{0}); }},
      {"/strands/offset ends at",
       [](hid_t file) { alter_value<std::uint64_t>(file, "/strands/offset", H5T_NATIVE_UINT64, 5, 1000); }},
      {"strand 3 is in region 9",
       [](hid_t file) { alter_value<std::uint32_t>(file, "/strands/region", H5T_NATIVE_UINT32, 3, 9); }},
      {"/strands/offset has no strand",
       [](hid_t file) { replace_dataset(file, "/strands/offset", H5T_STD_U64LE, {1}); }},
      {"/strands/offset does not have 1 dimensions",
       [](hid_t file) {
         replace_dataset(file, "/strands/offset", H5T_STD_U64LE, {6, 1});
       }},
      {"/strands/offset has another type",
       [](hid_t file) { replace_dataset(file, "/strands/offset", H5T_IEEE_F32LE, {6}); }},
      {"/strands/offset claims",
       [](hid_t file) { replace_dataset(file, "/strands/offset", H5T_STD_U64LE, {hsize_t{1} << 50}); }},
      {"/strands/region has 4 values for 5 strands",
       [](hid_t file) { replace_dataset(file, "/strands/region", H5T_STD_U32LE, {4}); }},
      {"/strands/root_uv does not have two",
       [](hid_t file) {
         replace_dataset(file, "/strands/root_uv", H5T_IEEE_F32LE, {5, 3});
       }},
      {"/regions/name does not hold strings",
       [](hid_t file) { replace_dataset(file, "/regions/name", H5T_STD_U32LE, {3}); }},
      {"/rest/position", [](hid_t file) { H5Ldelete(file, "/rest/position", H5P_DEFAULT); }},
      {"/rest/position does not have 3 columns",
       [=](hid_t file) {
         replace_dataset(file, "/rest/position", H5T_IEEE_F32LE, {vertices, 2});
       }},
      {"/rest/position claims",
       [=](hid_t file) {
         replace_dataset(file, "/rest/position", H5T_IEEE_F32LE, {hsize_t{1} << 40, 3});
       }},
      {"a frame of /frames/position has another shape",
       [=](hid_t file) {
         replace_dataset(file, "/frames/position", H5T_IEEE_F32LE, {2, vertices + 1, 3});
       }},
      {"a frame of /frames/head has another shape",
       [](hid_t file) {
         replace_dataset(file, "/frames/head", H5T_IEEE_F64LE, {2, 3, 4});
       }},
      {"/frames/collider does not have four numbers",
       [](hid_t file) {
         replace_dataset(file, "/frames/collider", H5T_IEEE_F64LE, {2, 2, 3});
       }},
      {"/frames/collider claims",
       [](hid_t file) {
         replace_dataset(file, "/frames/collider", H5T_IEEE_F64LE, {hsize_t{1} << 40, 2, 4});
       }},
      {"complete, but has 1 to 2 frames",
       [](hid_t file) {
         set_extent(file, "/frames/collider", {1, 2, 4});
       }},
      {"complete, but has 2 to 3 frames", [=](hid_t file) { set_extent(file, "/frames/number", {3}); }},
      {"complete, but has 1 to 2 frames", [=](hid_t file) { set_extent(file, "/stats/largest_stretch", {1}); }},
      {"complete, but has 1 to 2 frames", [=](hid_t file) { set_extent(file, "/stats/residual", {1}); }},
      {"complete, but has 1 to 2 frames", [=](hid_t file) { set_extent(file, "/stats/substeps", {1}); }},
      {"/frames/position claims",
       [=](hid_t file) {
         set_extent(file, "/frames/position", {hsize_t{1} << 30, vertices, 3});
       }},
      {"/frames/position has impossible dimensions",
       [=](hid_t file) {
         set_extent(file, "/frames/position", {hsize_t{1} << 62, vertices, 3});
       }},
      {"fps is -1", [](hid_t file) { alter_attribute(file, "fps", H5T_NATIVE_DOUBLE, -1.0); }},
      {"attribute \"fps\"", [](hid_t file) { H5Adelete(file, "fps"); }},
      {"/provenance", [](hid_t file) { H5Ldelete(file, "/provenance", H5P_DEFAULT); }},
      {"/provenance/inputs has 1 names and 2 values",
       [](hid_t file) {
         const hid_t type = H5Tcopy(H5T_C_S1);
         replace_dataset(file, "/provenance/inputs/name", type, {1});
         H5Tclose(type);
       }},
  };
  for (const Lie& lie : lies) {
    CAPTURE(lie.message);
    write_sample(folder / "a.h5", header, {}, 1, 2);
    alter(folder / "a.h5", lie.change);
    CHECK_THAT(message_of(folder / "a.h5"), Catch::Contains("a.h5: is damaged: ") && Catch::Contains(lie.message));
  }
}

TEST_CASE("a frame that is announced but was never written is refused") {
  const Folder folder;
  const CacheHeader header = sample_header(5);
  const hsize_t vertices = header.rest_position.size();
  write_sample(folder / "a.h5", header, {}, 1, 2);
  alter(folder / "a.h5", [&](hid_t file) {
    set_extent(file, "/frames/position", {3, vertices, 3});
    set_extent(file, "/frames/number", {3});
    set_extent(file, "/frames/time", {3});
    set_extent(file, "/frames/head", {3, 4, 4});
    set_extent(file, "/frames/collider", {3, 2, 4});
    set_extent(file, "/stats/largest_stretch", {3});
    set_extent(file, "/stats/residual", {3});
    set_extent(file, "/stats/deepest_penetration", {3});
    set_extent(file, "/stats/substeps", {3});
  });
  const CacheReader reader(folder / "a.h5");
  std::vector<Eigen::Vector3f> positions(vertices);
  reader.read_position(1, positions);
  CHECK_THROWS_WITH(reader.read_position(2, positions), Catch::Contains("/frames/position lacks a part of row 2"));
}

TEST_CASE("a cache without colliders has no room for them, and one of many is cut into small chunks") {
  const Folder folder;
  for (const std::size_t colliders : {std::size_t{0}, std::size_t{1}, std::size_t{5000}}) {
    CacheHeader header = sample_header(5);
    header.colliders = colliders;
    write_sample(folder / "a.h5", header, {}, 1, 3);
    check_header(CacheReader(folder / "a.h5").header(), header);
    check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 3);
    CHECK(fs::file_size(folder / "a.h5") < 60000 + 4 * 32 * colliders);
    CacheWriter writer(folder / "b.h5", header, {});
    SampleFrame sample(header, {}, 1);
    sample.colliders.emplace_back();
    sample.frame.colliders = sample.colliders;
    CHECK_THROWS_WITH(writer.write(sample.frame), Catch::Contains("as many colliders"));
  }
}

TEST_CASE("an unfinished file counts the frames that are in all its parts") {
  const Folder folder;
  const CacheHeader header = sample_header(5);
  const hsize_t vertices = header.rest_position.size();
  write_sample(folder / "a.h5", header, {}, 1, 3);
  alter(folder / "a.h5", [&](hid_t file) {
    alter_attribute<std::uint8_t>(file, "complete", H5T_NATIVE_UINT8, 0);
    set_extent(file, "/frames/position", {4, vertices, 3});
    set_extent(file, "/frames/number", {2});
  });
  check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 2);
}

TEST_CASE("a cache that another program has cut into other chunks reads back") {
  const Folder folder;
  const CacheHeader header = sample_header(40);
  const hsize_t vertices = header.rest_position.size();
  const auto recut = [&](const std::function<void(hid_t)>& set_filters) {
    write_sample(folder / "a.h5", header, {}, 1, 5);
    alter(folder / "a.h5", [&](hid_t file) {
      std::vector<Eigen::Vector3f> all;
      for (int number = 1; number <= 5; ++number) {
        const SampleFrame sample(header, {}, number);
        all.insert(all.end(), sample.position.begin(), sample.position.end());
      }
      H5Lmove(file, "/frames/position", file, "/old", H5P_DEFAULT, H5P_DEFAULT);
      const hid_t old = H5Dopen2(file, "/old", H5P_DEFAULT);
      const hsize_t dims[3] = {5, vertices, 3};
      const hsize_t chunk[3] = {2, 7, 2};
      const hid_t space = H5Screate_simple(3, dims, nullptr);
      const hid_t list = H5Pcreate(H5P_DATASET_CREATE);
      H5Pset_chunk(list, 3, chunk);
      set_filters(list);
      const hid_t set = H5Dcreate2(file, "/frames/position", H5T_IEEE_F32LE, space, H5P_DEFAULT, list, H5P_DEFAULT);
      REQUIRE(H5Dwrite(set, H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, all.data()) >= 0);
      const hid_t scalar = H5Screate(H5S_SCALAR);
      const hid_t precision = H5Acreate2(set, "precision", H5T_IEEE_F64LE, scalar, H5P_DEFAULT, H5P_DEFAULT);
      const double zero = 0;
      H5Awrite(precision, H5T_NATIVE_DOUBLE, &zero);
      H5Aclose(precision);
      for (const hid_t id : {scalar, space}) H5Sclose(id);
      for (const hid_t id : {set, old}) H5Dclose(id);
      H5Pclose(list);
    });
  };
  recut([](hid_t) {});
  check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 5);
  recut([](hid_t list) { H5Pset_deflate(list, 3); });
  check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 5);
  recut([](hid_t list) {
    H5Pset_shuffle(list);
    H5Pset_deflate(list, 9);
  });
  check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 5);
  recut([](hid_t list) { H5Pset_fletcher32(list); });
  CHECK_THAT(message_of(folder / "a.h5"), Catch::Contains("another filter than shuffle and deflate"));
}

TEST_CASE("a damaged chunk is refused when its frame is read") {
  const Folder folder;
  const CacheHeader header = sample_header(200);
  write_sample(folder / "a.h5", header, {}, 1, 2);
  // Garbage to be inflated; then bytes that claim to have passed no filter, but are too few.
  for (const std::uint32_t skipped_filters : {0U, 3U}) {
    alter(folder / "a.h5", [=](hid_t file) {
      const hid_t set = H5Dopen2(file, "/frames/position", H5P_DEFAULT);
      const hsize_t corner[3] = {1, 0, 0};
      const std::string garbage(1000, 'x');
      REQUIRE(H5Dwrite_chunk(set, H5P_DEFAULT, skipped_filters, corner, garbage.size(), garbage.data()) >= 0);
      H5Dclose(set);
    });
    const CacheReader reader(folder / "a.h5");
    std::vector<Eigen::Vector3f> positions(reader.vertex_count());
    reader.read_position(0, positions);
    CHECK_THROWS_WITH(reader.read_position(1, positions), Catch::Contains("/frames/position has a chunk"));
  }
}

TEST_CASE("a place where no file can be made is refused before anything is written") {
  const Folder folder;
  const CacheHeader header = sample_header(2);
  CHECK_THROWS_WITH(CacheWriter(folder / "none/a.h5", header, {}), Catch::Contains("there is no folder"));
  CHECK_THROWS_AS(CacheWriter(folder / "none/a.h5", header, {}), DiskError);
  CHECK_THROWS_WITH(CacheWriter(folder.path, header, {}), Catch::Contains("is a folder"));
  fs::create_directory(folder / "b.h5.part");
  CHECK_THROWS_AS(CacheWriter(folder / "b.h5", header, {}), DiskError);
  if (::geteuid() == 0) {
    WARN("skipped: the check of a folder without permission, because root may write everywhere");
    return;
  }
  fs::create_directory(folder / "closed");
  fs::permissions(folder / "closed", fs::perms::owner_read | fs::perms::owner_exec);
  CHECK_THROWS_WITH(CacheWriter(folder / "closed/a.h5", header, {}), Catch::Contains("Permission denied"));
}

TEST_CASE("a second writer of the same file is refused, and the first one goes on") {
  const Folder folder;
  const CacheHeader header = sample_header(2);
  CacheWriter first(folder / "a.h5", header, {});
  first.write(SampleFrame(header, {}, 1).frame);
  CHECK_THROWS_WITH(CacheWriter(folder / "a.h5", header, {}), Catch::Contains("being written by another program"));
  first.write(SampleFrame(header, {}, 2).frame);
  first.finish();
  check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 2);
}

TEST_CASE("a full disk is told at once, and leaves the frames before it and the old cache") {
  const Folder folder;
  const CacheHeader header = sample_header(2000);
  const CacheOptions options = {.deflate = 0, .threads = GENERATE(1, 3)};
  write_sample(folder / "a.h5", header, options, 1, 1);
  const std::string old_digest = sha256_file(folder / "a.h5");
  // One frame takes 192 kB and the beginning takes 240 kB; the odd sizes fall into metadata and small data sets as
  // well.
  for (rlim_t limit = 1000; limit < 1500000; limit += 33331) {
    CAPTURE(limit);
    int frames = 0;
    bool created = false;
    {
      const FileSizeLimit full(limit);
      try {
        CacheWriter writer(folder / "a.h5", header, options);
        created = true;
        try {
          for (; frames < 10; ++frames) writer.write(SampleFrame(header, options, frames + 1).frame);
          FAIL("ten frames have room");
        } catch (const DiskError& error) {
          CHECK_THAT(error.what(),
                     Catch::Contains("a.h5.part: cannot write frame") && Catch::Contains("File too large"));
          CHECK_THROWS_AS(writer.write(SampleFrame(header, options, 1).frame), DiskError);
          CHECK_THROWS_AS(writer.finish(), DiskError);
          writer.close();
        }
      } catch (const DiskError& error) {
        CHECK_THAT(error.what(), Catch::Contains("a.h5.part: cannot be created"));
      }
    }
    CHECK(fs::exists(folder / "a.h5.part") == created);
    if (created) check_frames(CacheReader(folder / "a.h5.part"), header, options, 1, frames);
    CHECK(sha256_file(folder / "a.h5") == old_digest);
  }
}

TEST_CASE("a disk that fills up as the cache is finished keeps the .part and the old cache") {
  const Folder folder;
  const CacheHeader header = sample_header(3);
  std::ofstream(folder / "a.h5") << "the old one";
  CacheWriter writer(folder / "a.h5", header, {});
  writer.write(SampleFrame(header, {}, 1).frame);
  {
    const FileSizeLimit full(100);
    CHECK_THROWS_AS(writer.finish(), DiskError);
  }
  check_frames(CacheReader(folder / "a.h5.part"), header, {}, 1, 1);
  CHECK(fs::file_size(folder / "a.h5") == 11);
}

TEST_CASE("a cache that cannot get its name stays complete under the other") {
  const Folder folder;
  const CacheHeader header = sample_header(3);
  CacheWriter writer(folder / "a.h5", header, {});
  writer.write(SampleFrame(header, {}, 1).frame);
  fs::create_directory(folder / "a.h5");
  CHECK_THROWS_WITH(writer.finish(), Catch::Contains("cannot be renamed"));
  CHECK(CacheReader(folder / "a.h5.part").complete());
}

TEST_CASE("an old cache stays untouched until the new one is finished") {
  const Folder folder;
  const CacheHeader header = sample_header(3);
  write_sample(folder / "a.h5", header, {}, 1, 1);
  CacheWriter writer(folder / "a.h5", header, {});
  writer.write(SampleFrame(header, {}, 7).frame);
  check_frames(CacheReader(folder / "a.h5"), header, {}, 1, 1);
  writer.finish();
  check_frames(CacheReader(folder / "a.h5"), header, {}, 7, 7);
}

TEST_CASE("frames and headers of a wrong size are the caller's mistake") {
  const Folder folder;
  const CacheHeader good = sample_header(3);
  const auto refused = [&](const std::function<void(CacheHeader&, CacheOptions&)>& change) {
    CacheHeader header = good;
    CacheOptions options;
    change(header, options);
    CHECK_THROWS_AS(CacheWriter(folder / "a.h5", header, options), std::invalid_argument);
    CHECK_FALSE(fs::exists(folder / "a.h5.part"));
  };
  refused([](CacheHeader& header, CacheOptions&) { header.offset.clear(); });
  refused([](CacheHeader& header, CacheOptions&) { header.offset = {0}; });
  refused([](CacheHeader& header, CacheOptions&) { header.offset[1] = 0; });
  refused([](CacheHeader& header, CacheOptions&) { header.rest_position.pop_back(); });
  refused([](CacheHeader& header, CacheOptions&) { header.region.pop_back(); });
  refused([](CacheHeader& header, CacheOptions&) { header.region[0] = 3; });
  refused([](CacheHeader& header, CacheOptions&) { header.root_uv.pop_back(); });
  refused([](CacheHeader& header, CacheOptions&) { header.fps = 0; });
  refused([](CacheHeader&, CacheOptions& options) { options.deflate = 13; });
  refused([](CacheHeader&, CacheOptions& options) { options.deflate = -1; });
  refused([](CacheHeader&, CacheOptions& options) { options.precision = -1; });
  refused([](CacheHeader&, CacheOptions& options) { options.threads = 0; });

  CacheWriter writer(folder / "a.h5", good, {});
  SampleFrame sample(good, {.velocity = true}, 1);
  CHECK_THROWS_AS(writer.write(sample.frame), std::invalid_argument);  // velocities that the cache does not have
  sample.frame.velocity = {};
  sample.frame.position = sample.frame.position.first(1);
  CHECK_THROWS_AS(writer.write(sample.frame), std::invalid_argument);
  sample.frame.position = sample.position;
  writer.write(sample.frame);
  writer.finish();

  const CacheReader reader(folder / "a.h5");
  std::vector<Eigen::Vector3f> room(good.rest_position.size());
  CHECK_THROWS_AS(reader.read_position(0, std::span(room).first(2)), std::invalid_argument);
  CHECK_THROWS_AS(reader.read_position(1, room), std::out_of_range);
  CHECK_THROWS_AS(reader.frame_number(1), std::out_of_range);
  CHECK_THROWS_AS(reader.read_velocity(0, room), std::logic_error);
}

TEST_CASE("HDF5's own printing is as it was after our calls") {
  const Folder folder;
  H5E_auto2_t before = nullptr;
  H5E_auto2_t after = nullptr;
  void* data = nullptr;
  H5Eget_auto2(H5E_DEFAULT, &before, &data);
  write_sample(folder / "a.h5", sample_header(2), {}, 1, 1);
  CHECK_THROWS_AS(CacheReader(folder / "none.h5"), InputError);
  H5Eget_auto2(H5E_DEFAULT, &after, &data);
  CHECK(before == after);
}
