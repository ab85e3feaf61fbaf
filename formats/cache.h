// The strand cache: one HDF5 file with every vertex of every frame. docs/CACHE.md describes the layout for readers.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "formats/error.h"
#include "sim/frame_input.h"

namespace strandbake {

struct CacheOptions {
  int deflate = 1;        // level 0 .. 12 of libdeflate; 0: chunks are stored as they are ("none")
  double precision = 0;   // positions are rounded by at most half of this [m]; 0: not rounded
  bool velocity = false;  // write /frames/velocity
  bool stats = true;      // write /stats
  int threads = 1;        // that encode at once, at most; has no influence on the bytes
};

// What is known before the first frame.
struct CacheHeader {
  double fps = 24;
  std::vector<std::uint64_t> offset;           // as Groom::offset
  std::vector<std::uint32_t> region;           // [strands]
  std::vector<std::string> region_names;       // [regions]
  std::vector<Eigen::Vector2f> root_uv;        // [strands] or empty
  std::vector<Eigen::Vector3f> rest_position;  // [vertices], world of the rest frame [m]
  std::size_t colliders = 0;                   // spheres in each frame
  std::string program_version;
  std::string scene_text;                                       // the scene as read, then its overrides
  std::vector<std::pair<std::string, std::string>> inputs;      // name as the scene has it, sha256 in hex
  std::vector<std::pair<std::string, std::string>> parameters;  // dotted path, value as text: every setting in force
};

struct FrameStats {
  float largest_stretch = 0;      // max over segments of |length / rest length - 1|
  float residual = 0;             // the same over segments that pinned vertices hold at both ends
  float deepest_penetration = 0;  // [m], max over free vertices and spheres, 0 where none is inside
  std::int32_t substeps = 0;      // that led to the frame, 0 for the one that hair starts in
};

struct CacheFrame {
  int number = 0;                             // scene frame
  double time = 0;                            // [s], number / fps
  std::span<const Eigen::Vector3f> position;  // [vertices], world [m]
  // Tells the velocities [m/s] of the vertices from `first` on; empty where the cache has none. Any number of threads
  // may ask at once.
  std::function<void(std::size_t first, std::span<Eigen::Vector3f> out)> velocity;
  Eigen::Isometry3d head = Eigen::Isometry3d::Identity();  // rest frame to now
  std::span<const Sphere> colliders;                       // [CacheHeader::colliders]
  FrameStats stats;
};

// Writes `path` + ".part"; finish() renames it. Left without finish(), the .part stays, readable, with the frames that
// were written; left without finish(), close() and a single frame, it goes. Throws DiskError.
//
// A frame is written in three steps, so that the threads of a solver can do most of it: begin(), work(), end().
class CacheWriter {
 public:
  // What becomes of a .part that is there already. Resume goes on with it, to the bytes of a file that was written in
  // one go; a .part that a killed program had not begun yet counts as none. Throws InputError where header or options
  // are not those that it was begun with, or it is damaged.
  enum class Existing { Replace, Resume };
  CacheWriter(const std::filesystem::path& path, const CacheHeader& header, const CacheOptions& options,
              Existing existing = Existing::Replace);
  ~CacheWriter();
  CacheWriter(const CacheWriter&) = delete;
  CacheWriter& operator=(const CacheWriter&) = delete;

  // That are in the file.
  std::size_t frame_count() const;

  // The frame, and what it refers to, must stay until end(), which is the first to look at its statistics.
  void begin(const CacheFrame& frame);
  // Encodes and writes chunks of the frame that was begun. Any number of threads may call it at once; those beyond the
  // threads of the options return at once. The others return when nothing is left to take, with `may_wait` when all
  // chunks are written. Throws nothing: what goes wrong, end() tells.
  void work(bool may_wait);
  // Does what is left, on the threads of the options, and commits the frame. No other thread may still be in work().
  void end();
  // All at once.
  void write(const CacheFrame& frame) {
    begin(frame);
    end();
  }
  // Closes the file and gives it its final name. Nothing can be written after it.
  void finish();
  // Closes the .part without renaming it, so that its bytes are on disk; the destructor does it too, but cannot throw.
  // A frame that was begun and not ended is dropped.
  void close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Whether there is a .part of this cache that a writer can go on with.
bool has_begun(const std::filesystem::path& path);

// Opens a cache or a .part. Throws InputError for anything that is not one, is damaged, or is of a newer format
// version.
class CacheReader {
 public:
  explicit CacheReader(const std::filesystem::path& path);
  ~CacheReader();
  CacheReader(CacheReader&&) noexcept;
  CacheReader& operator=(CacheReader&&) noexcept;

  const CacheHeader& header() const;
  const CacheOptions& options() const;  // as far as the file tells
  std::size_t frame_count() const;      // finished frames
  std::size_t vertex_count() const;
  bool complete() const;  // finish() was reached
  int frame_number(std::size_t index) const;
  double frame_time(std::size_t index) const;
  Eigen::Isometry3d head(std::size_t index) const;
  // As many as the header says; none in caches of versions that did not write them. Numbers are as they stand in the
  // file, finite or not.
  std::span<const Sphere> colliders(std::size_t index) const;
  std::optional<FrameStats> stats(std::size_t index) const;
  bool has_velocity() const;
  std::uint64_t stored_bytes() const;  // bytes that positions take in the file
  void read_position(std::size_t index, std::span<Eigen::Vector3f> out) const;
  // Vertices from `first` on. Any number of threads may read at once, also from several caches.
  void read_position(std::size_t index, std::size_t first, std::span<Eigen::Vector3f> out) const;
  // Packed bytes of the chunk of a frame that begins with vertex `first`, and how many there are.
  enum class Vectors { Position, Velocity };
  std::size_t packed_bytes(Vectors which, std::size_t index, std::size_t first) const;
  std::vector<std::byte> read_packed(Vectors which, std::size_t index, std::size_t first) const;
  // Vertices that are packed together: block b holds those from b * block_vertices() on. Reading by whole blocks
  // unpacks nothing twice.
  std::size_t block_vertices() const;
  void read_velocity(std::size_t index, std::span<Eigen::Vector3f> out) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// A position as the cache stores it: the nearest multiple (ties to even) of the largest power of two that is not above
// `precision`. A float holds it exactly, so the error is at most precision / 2. Powers of two clear the low bits of the
// mantissa, which is what deflate can pack: multiples of 1e-5 itself take as much room as unrounded floats.
// precision 0 returns v, and so does what has no such multiple: infinities, NaN, a multiple beyond the largest float.
float round_to_precision(float v, double precision);

}  // namespace strandbake
