#include "gpu/opencl_solver.h"

#include <omp.h>

#include <algorithm>
#include <bit>
#include <exception>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <stdexcept>
#include <vector>

#include "gpu/kernels/layout.h"
#include "gpu/program.h"
#include "sim/large_array.h"
#include "sim/parallel.h"
#include "sim/solver_state.h"
#include "sim/strand_blocks.h"

namespace strandbake {
namespace {

constexpr std::size_t kItemGroup = 64;            // work-items of a group where each has a strand
constexpr std::size_t kVertexGroup = 256;         // and, at most, where each has a vertex
constexpr std::size_t kManyStrands = 8192;        // enough to keep a device busy with a strand per work-item
constexpr std::size_t kScratchBytes = 64u << 20;  // for strands that are too long for local memory, of one launch

// Vectors of three numbers a vertex that a group shares: p and q, for methods 2 and 4 two of the frames, for 4 the
// scan or direct lengths.
std::size_t shared_rows(int method, bool direct_lengths) {
  const std::size_t frames = method == 2 || method == 4 ? 2 : 0;
  return 2 + frames + (method == 4 || direct_lengths ? 1 : 0);
}

// The local shape that a region's kernel is compiled for; 0: none.
int method_of(const RegionPlan& region) {
  return region.local_shape ? region.local_method : 0;
}

// Groups that run in one launch of a kernel.
struct Launch {
  enum class Kind { Strands, Vertices, LongVertices };
  Kind kind;
  int method = 0;  // of Vertices and LongVertices
  Buffer which;    // block numbers within the batch
  std::size_t blocks = 0;
  std::size_t capacity = 0;  // vertices of the longest
};

// Strands whose state is one buffer.
struct Batch {
  std::size_t first_block = 0, block_count = 0;
  std::size_t first_number = 0, numbers = 0;  // of the state as a whole
  Buffer state;                               // where batches are streamed, all share one: empty
  std::vector<BlockRow> rows;                 // [block_count]
  Buffer blocks, targets;
  std::vector<Launch> launches;
};

template <class Scalar>
class Implementation final : public OpenCLSolver {
 public:
  Implementation(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head, const Device& device,
                 const OpenCLOptions& options);
  ~Implementation() override {
    // Nothing may still be at work on memory that goes away.
    if (compute_) opencl().Finish(compute_.get());
    if (landed_ != nullptr) {
      opencl().EnqueueUnmapMemObject(transfer_.get(), landing_.get(), landed_, 0, nullptr, nullptr);
    }
    if (transfer_) opencl().Finish(transfer_.get());
  }

  using Solver::advance;
  void advance(const FrameInput& input, std::span<Eigen::Vector3f> out, Figures* figures,
               const Alongside& alongside) override;
  Figures measure_at_start(std::span<const Sphere> spheres) override;
  void expect(const FrameInput& next) override { expected_ = next; }
  void read(std::span<Eigen::Vector3f> out) const override { read_as(out); }
  void read(std::span<Eigen::Vector3d> out) const override { read_as(out); }
  std::optional<NonFinite> find_non_finite() const override { return non_finite_; }
  void save(const Sink& out) const override;
  void load(const Source& in) override;
  std::size_t state_bytes() const override { return numbers_ * sizeof(Scalar); }
  WorkCount work() const override { return {}; }
  OpenCLReport report() const override { return report_; }
  double kernel_seconds() const override { return kernel_seconds_; }

 private:
  // Places in a batch are 32-bit numbers.
  static constexpr std::uint64_t kMostBytes = std::uint64_t{kAbsent} * sizeof(Scalar);

  Buffer make_buffer(std::size_t bytes, const void* content, cl_mem_flags flags = CL_MEM_READ_WRITE) const;
  template <class... Arguments>
  void set(const Kernel& kernel, const Arguments&... arguments) const;
  void choose_width(const Groom& groom);
  std::size_t item_group() const { return std::bit_floor(std::min(kItemGroup, device_.largest_group)); }
  std::size_t vertex_group() const { return std::bit_floor(std::min(kVertexGroup, device_.largest_group)); }
  // Does its hair more than ride?
  bool runs(const RegionPlan& region) const { return region.simulated || !options_.skip.regions; }
  bool any_direct_lengths() const {
    return std::any_of(plan_.regions.begin(), plan_.regions.end(),
                       [&](const RegionPlan& r) { return runs(r) && r.direct_lengths; });
  }
  std::string build_options(bool any_masked, bool any_rides) const;
  std::size_t shared_numbers(int method, std::size_t vertices) const {
    return shared_rows(method, any_direct_lengths()) * 3 * vertices * static_cast<std::size_t>(strands_->width);
  }
  Launch::Kind kind_of(const Placed<Scalar>& placed) const;
  std::set<std::pair<Launch::Kind, int>> kernels_of_vertices() const;
  // Where the numbers of a block begin in the state; of the block after the last, where they end.
  std::size_t block_begin(std::size_t b) const {
    const auto& blocks = strands_->blocks;
    return b < blocks.size() ? static_cast<std::size_t>(blocks[b].block.position - host_state_.data()) : numbers_;
  }
  std::uint64_t largest_block_bytes() const;
  std::uint64_t largest_batch_bytes() const;
  void place(const Groom& groom, std::uint64_t budget);
  void cut_into_batches(std::uint64_t budget);
  void make_batch(Batch& batch, const Groom& groom);
  void make_landing();
  void start(const FrameInput& input);
  void simulate(const Batch& batch, cl_mem state, cl_uint substeps);
  void gather(const Batch& batch, cl_mem state, cl_uint swapped) const;
  void measure(const Batch& batch, cl_mem state, cl_uint swapped) const;
  void clear_figures() const;
  Figures found_figures() const;
  void run_batches(cl_uint substeps);
  template <class Out>
  void read_as(std::span<Out> out) const;
  // What blocks hold of a vertex, by region: work-items by vertices have theirs in the memory that a group shares.
  std::vector<std::size_t> scratch() const {
    std::vector<std::size_t> numbers;
    for (std::size_t r = 0; r < mapping_.size(); ++r) {
      const RegionPlan& region = plan_.regions[r];
      std::size_t of_vertex = 0;
      if (region.rod) {
        of_vertex = region.rod_stretch > 0 ? kRodStretchRow : kRodExactRow;
      } else if (region.direct_lengths && mapping_[r] == Mapping::Strands) {
        of_vertex = kLengthRow;
      }
      numbers.push_back(of_vertex);
    }
    return numbers;
  }
  void fetch_state(LargeArray<Scalar>& home) const;
  void run_frame(const FrameInput& input, std::span<Eigen::Vector3f> out, Figures* figures, const Alongside& alongside);
  void take_landed(std::span<Eigen::Vector3f> out) const;
  void find_non_finite_in(std::span<const Eigen::Vector3f> positions);
  void count_kernel_time();

  const OpenCL& cl_ = opencl();
  Device device_;
  OpenCLOptions options_;
  Plan plan_;
  std::vector<std::uint64_t> offset_;
  std::optional<StrandBlocks<Scalar>> strands_;
  std::optional<Origin> origin_;
  Eigen::Vector3d rest_weight_;            // gravity that sag-free hair is in balance with, in the rest frame [m/s^2]
  std::vector<Mapping> mapping_;           // [regions]
  std::size_t numbers_ = 0;                // of the state
  mutable LargeArray<Scalar> host_state_;  // where batches are streamed

  // In the order in which they have to go: queues and kernels before buffers, all before the context.
  Context context_;
  Buffer region_reals_, region_ints_, substep_reals_, substep_ints_, spheres_, scratch_, streamed_state_;
  Buffer positions_, not_finite_, figures_, landing_;
  Program program_;
  Kernel advance_strands_, gather_, measure_;
  std::map<std::pair<Launch::Kind, int>, Kernel> advance_vertices_;
  std::vector<Batch> batches_;
  Queue compute_, transfer_;
  std::vector<Event> events_;     // of the kernels that simulate the frame started last
  std::vector<Event> finishing_;  // and the one before it

  Eigen::Vector3f* landed_ = nullptr;  // where positions arrive that travel: landing_; nullptr: where they are wanted

  bool swapped_ = false;       // the newest positions stand in Block::previous
  double substep_before_ = 0;  // [s], 0 before the first frame
  std::optional<FrameInput> expected_;
  bool started_ = false;             // the device is at work on the frame that the next advance() will ask for
  std::exception_ptr next_failure_;  // why it could not begin
  cl_uint sphere_begin_ = 0, sphere_count_ = 0;  // of the last substep, in spheres_
  bool measuring_ = false;                       // the frame that batches take turns for
  cl_uint found_not_finite_ = 0;
  cl_float found_[3] = {};  // of measure.cl
  std::optional<NonFinite> non_finite_;
  double kernel_seconds_ = 0;
  OpenCLReport report_;
};

template <class Scalar>
Buffer Implementation<Scalar>::make_buffer(std::size_t bytes, const void* content, cl_mem_flags flags) const {
  cl_int status = CL_SUCCESS;
  // Copied as it is made: a write would wait in the queue behind kernels.
  const bool copies = content != nullptr && bytes > 0;
  if (copies) flags |= CL_MEM_COPY_HOST_PTR;
  Buffer buffer(cl_.CreateBuffer(context_.get(), flags, std::max<std::size_t>(bytes, 1),
                                 copies ? const_cast<void*>(content) : nullptr, &status));
  if (status == CL_OUT_OF_RESOURCES || status == CL_OUT_OF_HOST_MEMORY) status = CL_MEM_OBJECT_ALLOCATION_FAILURE;
  check_opencl(status, "reserve memory");
  return buffer;
}

// A buffer, a number, or LocalMemory.
struct LocalMemory {
  std::size_t bytes;
};

template <class Scalar>
template <class... Arguments>
void Implementation<Scalar>::set(const Kernel& kernel, const Arguments&... arguments) const {
  cl_uint index = 0;
  const auto one = [&](const auto& argument) {
    using Argument = std::decay_t<decltype(argument)>;
    cl_int status = CL_SUCCESS;
    if constexpr (std::is_same_v<Argument, LocalMemory>) {
      status = cl_.SetKernelArg(kernel.get(), index++, argument.bytes, nullptr);
    } else {
      status = cl_.SetKernelArg(kernel.get(), index++, sizeof argument, &argument);
    }
    check_opencl(status, "take a kernel's argument");
  };
  (one(arguments), ...);
}

// By vertices, as many strands as make a group of kVertexGroup items together, and fewer where the longest would not
// fit local memory otherwise; by strands alone, as many as a group has items.
template <class Scalar>
void Implementation<Scalar>::choose_width(const Groom& groom) {
  std::size_t strands = 0, vertices = 0, longest = 0, largest = 0;
  for (std::size_t s = 0; s < groom.strand_count(); ++s) {
    const std::uint32_t region = groom.region.empty() ? 0 : groom.region[s];
    if (region >= mapping_.size() || mapping_[region] == Mapping::Strands) continue;
    strands += 1;
    vertices += groom.vertex_count(s);
    longest = std::max(longest, groom.vertex_count(s));
    largest = std::max(
        largest, shared_rows(method_of(plan_.regions[region]), any_direct_lengths()) * 3 * sizeof(Scalar) * longest);
  }
  std::size_t width = item_group();
  if (strands > 0) {
    width = std::min(width, std::bit_floor(std::max<std::size_t>(1, vertex_group() * strands / vertices)));
    if (largest <= device_.local_memory) width = std::min(width, std::bit_floor(device_.local_memory / largest));
  }
  report_.strands_in_a_block = static_cast<int>(width);
}

template <class Scalar>
std::string Implementation<Scalar>::build_options(bool any_masked, bool any_rides) const {
  const std::string real = sizeof(Scalar) == 4 ? "float" : "double";
  std::string options = "-DREAL=" + real + " -DREAL3=" + real + "3 -DWIDTH=" + std::to_string(strands_->width) +
                        " -DITEM_GROUP=" + std::to_string(item_group()) +
                        " -DVERTEX_GROUP=" + std::to_string(vertex_group());
  const auto define = [&](bool condition, const char* name) {
    if (condition) options += std::string(" -D") + name;
  };
  const auto any = [&](const auto& has) {
    return std::any_of(plan_.regions.begin(), plan_.regions.end(),
                       [&](const RegionPlan& region) { return runs(region) && has(region); });
  };
  define(any_masked, "HAS_MASKED");
  define(any_rides, "HAS_RIDES");
  define(any([](const RegionPlan& r) { return r.wind; }), "HAS_WIND");
  define(any([](const RegionPlan& r) { return r.sag_free && !r.rod; }), "HAS_SUPPORT");
  define(any([](const RegionPlan& r) { return r.global_shape; }), "HAS_GLOBAL_SHAPE");
  define(any([](const RegionPlan& r) { return r.local_shape; }), "HAS_LOCAL_SHAPE");
  define(any([](const RegionPlan& r) { return r.local_shape && r.reacts; }), "HAS_REACTION");
  define(!any([](const RegionPlan& r) { return r.local_shape && !r.reacts; }), "ALL_REACT");
  define(any([](const RegionPlan& r) { return r.edge_lengths && !r.direct_lengths; }), "HAS_EDGE_LENGTHS");
  define(any_direct_lengths(), "HAS_DIRECT_LENGTHS");
  define(any([](const RegionPlan& r) { return r.rod; }), "HAS_ROD");
  define(any([](const RegionPlan& r) { return r.rod_stretch > 0; }), "HAS_ROD_STRETCH");
  define(plan_.colliders, "HAS_SPHERES");
  define(plan_.measured, "HAS_FIGURES");
  int method = 0;  // that all regions with a strand per work-item agree on, -1: they do not
  for (std::size_t r = 0; r < plan_.regions.size(); ++r) {
    const RegionPlan& region = plan_.regions[r];
    if (!runs(region) || !region.local_shape || mapping_[r] != Mapping::Strands) continue;
    method = method == 0 || method == region.local_method ? region.local_method : -1;
  }
  if (method > 0) options += " -DLOCAL_METHOD=" + std::to_string(method);
  for (const auto& [kind, of_method] : kernels_of_vertices()) {
    options += " -D" + std::string("VERTICES_METHOD_") + std::to_string(of_method) +
               (kind == Launch::Kind::Vertices ? "_LOCAL" : "_GLOBAL");
  }
  // Options that a driver does not know would fail the build; where a device cannot divide exactly there is none.
  cl_device_fp_config config{};
  cl_.GetDeviceInfo(device_.id, CL_DEVICE_SINGLE_FP_CONFIG, sizeof config, &config, nullptr);
  if ((config & CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT) != 0) options += " -cl-fp32-correctly-rounded-divide-sqrt";
  return options;
}

template <class Scalar>
Launch::Kind Implementation<Scalar>::kind_of(const Placed<Scalar>& placed) const {
  if (mapping_[placed.region] == Mapping::Strands) return Launch::Kind::Strands;
  const std::size_t numbers =
      shared_numbers(method_of(plan_.regions[placed.region]), static_cast<std::size_t>(placed.block.vertices));
  return numbers * sizeof(Scalar) <= device_.local_memory ? Launch::Kind::Vertices : Launch::Kind::LongVertices;
}

template <class Scalar>
std::set<std::pair<Launch::Kind, int>> Implementation<Scalar>::kernels_of_vertices() const {
  std::set<std::pair<Launch::Kind, int>> kernels;
  for (const Placed<Scalar>& placed : strands_->blocks) {
    const Launch::Kind kind = kind_of(placed);
    if (kind != Launch::Kind::Strands) kernels.emplace(kind, method_of(plan_.regions[placed.region]));
  }
  return kernels;
}

// Whole blocks, as many as fit `budget` bytes and a buffer of the device, at least one.
template <class Scalar>
void Implementation<Scalar>::cut_into_batches(std::uint64_t budget) {
  const std::uint64_t most = std::min({budget, device_.largest_buffer, kMostBytes});
  const std::size_t blocks = strands_->blocks.size();
  for (std::size_t b = 0; b < blocks;) {
    Batch batch;
    batch.first_block = b;
    batch.first_number = block_begin(b);
    do {
      ++b;
    } while (b < blocks && (block_begin(b + 1) - batch.first_number) * sizeof(Scalar) <= most);
    batch.block_count = b - batch.first_block;
    batch.numbers = block_begin(b) - batch.first_number;
    batches_.push_back(std::move(batch));
  }
}

template <class Scalar>
void Implementation<Scalar>::make_batch(Batch& batch, const Groom& groom) {
  const Scalar* const base = host_state_.data() + batch.first_number;
  std::vector<BlockRow>& rows = batch.rows;
  std::vector<Target> targets;
  struct Bucket {
    Launch::Kind kind;
    int method;
    std::size_t size;  // a power of two above all strands in it; 0 for strands
    std::size_t capacity = 0;
    std::vector<cl_uint> which = {};
  };
  std::vector<Bucket> buckets;
  for (std::size_t b = 0; b < batch.block_count; ++b) {
    const Placed<Scalar>& placed = strands_->blocks[batch.first_block + b];
    const Block<Scalar>& block = placed.block;
    const auto place = [&](const Scalar* array) {
      return array == nullptr ? kAbsent : static_cast<uint>(array - base);
    };
    BlockRow row{};
    row.vertices = static_cast<uint>(block.vertices);
    row.region = placed.region;
    row.simulated = plan_.regions[placed.region].simulated;
    row.masked = block.masked;
    row.rides = block.rides;
    row.global_end = static_cast<uint>(block.global_end);
    row.position = place(block.position);
    row.previous = place(block.previous);
    row.rest = place(block.rest);
    row.root_frame = place(block.root_frame);
    row.local_edge = place(block.local_edge);
    row.remainder = place(block.remainder);
    row.lever = place(block.lever);
    row.frame_x = place(block.frame_x);
    row.frame_y = place(block.frame_y);
    row.support = place(block.support);
    row.length = place(block.length);
    row.tension = place(block.tension);
    row.rest_curvature = place(block.rest_curvature);
    row.drawn = place(block.drawn);
    row.handed_back = place(block.handed_back);
    row.pressed = place(block.pressed);
    row.fade = place(block.fade);
    row.free = place(block.free);
    row.active = place(block.active);
    row.swept = place(block.swept);
    row.elimination = place(block.elimination);
    row.wind_weight = place(block.wind_weight);
    rows.push_back(row);
    for (int lane = 0; lane < strands_->width; ++lane) {
      Target target{0, 0};
      if (lane < placed.count) {
        const std::size_t strand = strands_->strand_order[placed.first + static_cast<std::size_t>(lane)];
        target = {static_cast<uint>(offset_[strand]), static_cast<uint>(groom.vertex_count(strand))};
      }
      targets.push_back(target);
    }
    const auto vertices = static_cast<std::size_t>(block.vertices);
    Bucket wanted{kind_of(placed), 0, 0};
    if (wanted.kind != Launch::Kind::Strands) {
      wanted.method = method_of(plan_.regions[placed.region]);
      wanted.size = std::bit_ceil(std::max<std::size_t>(vertices, 8));
    }
    auto bucket = std::find_if(buckets.begin(), buckets.end(), [&](const Bucket& x) {
      return x.kind == wanted.kind && x.method == wanted.method && x.size == wanted.size;
    });
    if (bucket == buckets.end()) bucket = buckets.insert(buckets.end(), wanted);
    bucket->capacity = std::max(bucket->capacity, vertices);
    bucket->which.push_back(static_cast<cl_uint>(b));
  }
  batch.blocks = make_buffer(rows.size() * sizeof(BlockRow), rows.data(), CL_MEM_READ_ONLY);
  batch.targets = make_buffer(targets.size() * sizeof(Target), targets.data(), CL_MEM_READ_ONLY);
  for (const Bucket& bucket : buckets) {
    // Those that do not fit the scratch memory together run one after the other.
    std::size_t at_once = bucket.which.size();
    if (bucket.kind == Launch::Kind::LongVertices) {
      const std::size_t bytes = shared_numbers(bucket.method, bucket.capacity) * sizeof(Scalar);
      at_once = std::max<std::size_t>(1, kScratchBytes / bytes);
    }
    for (std::size_t first = 0; first < bucket.which.size(); first += at_once) {
      Launch launch;
      launch.kind = bucket.kind;
      launch.method = bucket.method;
      launch.blocks = std::min(at_once, bucket.which.size() - first);
      launch.capacity = bucket.capacity;
      launch.which = make_buffer(launch.blocks * sizeof(cl_uint), bucket.which.data() + first, CL_MEM_READ_ONLY);
      (bucket.kind == Launch::Kind::Strands    ? report_.strand_blocks
       : bucket.kind == Launch::Kind::Vertices ? report_.vertex_blocks
                                               : report_.long_blocks) += launch.blocks;
      batch.launches.push_back(std::move(launch));
    }
  }
}

template <class Scalar>
Implementation<Scalar>::Implementation(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head,
                                       const Device& device, const OpenCLOptions& options)
    : device_(device), options_(options), plan_(plan), offset_(groom.offset) {
  if (sizeof(Scalar) == 8 && !device.exact_double) {
    throw DeviceError(device.name + " has no double precision; use precision = \"float\" or --backend openmp");
  }
  if (groom.vertex_count() > kAbsent)
    throw DeviceError("a groom of over 4,294,967,295 vertices needs --backend openmp");
  for (const RegionPlan& region : plan.regions) {
    mapping_.push_back(runs(region) ? mapping_of(region, options.mapping, groom.strand_count()) : Mapping::Strands);
  }
  choose_width(groom);
  strands_.emplace(groom, plan, report_.strands_in_a_block, options.threads, options.skip);
  numbers_ = strands_->lay_out(plan, scratch(), nullptr);
  host_state_ = LargeArray<Scalar>(numbers_);
  strands_->lay_out(plan, scratch(), host_state_.data());
  origin_.emplace(strands_->center, head);
  rest_weight_ = head.linear().transpose() * plan.gravity_at_rest;
  const HeadTurn<Scalar> start(head);
  const auto block_count = static_cast<std::ptrdiff_t>(strands_->blocks.size());
  FirstException failure;
#pragma omp parallel for num_threads(options.threads) schedule(dynamic, 8)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    failure.guard(
        [&] { strands_->fill(groom, plan, start, rest_weight_, strands_->blocks[static_cast<std::size_t>(b)]); });
  }
  failure.rethrow();

  cl_int status = CL_SUCCESS;
  context_ = Context(cl_.CreateContext(nullptr, 1, &device_.id, nullptr, nullptr, &status));
  check_opencl(status, "be opened");
  compute_ = Queue(cl_.CreateCommandQueue(context_.get(), device_.id, CL_QUEUE_PROFILING_ENABLE, &status));
  check_opencl(status, "open a queue");
  transfer_ = Queue(cl_.CreateCommandQueue(context_.get(), device_.id, 0, &status));
  check_opencl(status, "open a queue");

  bool any_masked = false, any_rides = false;
  for (const Placed<Scalar>& placed : strands_->blocks) {
    any_masked |= placed.block.masked;
    any_rides |= placed.block.rides;
  }
  BuiltProgram built =
      build_program(context_.get(), device_, build_options(any_masked, any_rides), options.program_cache);
  program_ = std::move(built.program);
  report_.program_from_cache = built.from_cache;
  const auto kernel = [&](const char* name) {
    Kernel made(cl_.CreateKernel(program_.get(), name, &status));
    check_opencl(status, "make a kernel");
    return made;
  };
  advance_strands_ = kernel("advance_strands");
  for (const auto& [kind, method] : kernels_of_vertices()) {
    const std::string name =
        "advance_vertices_" + std::to_string(method) + (kind == Launch::Kind::Vertices ? "_local" : "_global");
    advance_vertices_[{kind, method}] = kernel(name.c_str());
  }
  gather_ = kernel("gather");
  if (plan_.measured) measure_ = kernel("measure");

  if (largest_block_bytes() > std::min(device_.largest_buffer, kMostBytes)) {
    throw DeviceError("strands of " + std::to_string(strands_->longest) +
                      " vertices are too long for the device's largest buffer");
  }
  // Without these nothing will do, however small the batches.
  positions_ = make_buffer(sizeof(Eigen::Vector3f) * groom.vertex_count(), nullptr);
  const cl_uint none = 0;
  not_finite_ = make_buffer(sizeof none, &none);
  figures_ = make_buffer(sizeof found_, nullptr);
  // All hair on the device if it fits, else in batches that take turns there, and smaller ones until all fits. Devices
  // may reserve memory late, so that only trying tells.
  std::uint64_t budget = options.memory > 0 ? options.memory : device_.memory;
  report_.streamed = numbers_ * sizeof(Scalar) > budget;
  for (bool fits = false; !fits;) {
    try {
      place(groom, budget);
      fits = true;
    } catch (const DeviceMemoryError&) {
      if (report_.streamed && batches_.size() == strands_->blocks.size()) throw;
      budget = report_.streamed ? std::min(budget, largest_batch_bytes()) / 2 : budget / 2;
      report_.streamed = true;
    }
  }
  if (!report_.streamed) host_state_ = {};
  if (!device_.shares_memory) make_landing();
}

template <class Scalar>
std::uint64_t Implementation<Scalar>::largest_block_bytes() const {
  std::uint64_t numbers = 0;
  for (std::size_t b = 0; b < strands_->blocks.size(); ++b) {
    numbers = std::max<std::uint64_t>(numbers, block_begin(b + 1) - block_begin(b));
  }
  return numbers * sizeof(Scalar);
}

template <class Scalar>
std::uint64_t Implementation<Scalar>::largest_batch_bytes() const {
  std::uint64_t numbers = 0;
  for (const Batch& batch : batches_) numbers = std::max<std::uint64_t>(numbers, batch.numbers);
  return numbers * sizeof(Scalar);
}

// All that depends on how hair is cut into batches. Throws DeviceMemoryError where it does not fit the device, with the
// batches that were tried in `batches_`.
template <class Scalar>
void Implementation<Scalar>::place(const Groom& groom, std::uint64_t budget) {
  batches_.clear();
  streamed_state_ = Buffer();
  scratch_ = Buffer();
  report_.strand_blocks = report_.vertex_blocks = report_.long_blocks = 0;
  cut_into_batches(budget);
  report_.batches = static_cast<int>(batches_.size());
  if (report_.streamed) streamed_state_ = make_buffer(largest_batch_bytes(), nullptr);
  std::size_t scratch_bytes = 0;
  for (Batch& batch : batches_) {
    if (!report_.streamed) {
      batch.state = make_buffer(batch.numbers * sizeof(Scalar), host_state_.data() + batch.first_number);
    }
    make_batch(batch, groom);
    for (const Launch& launch : batch.launches) {
      const std::size_t bytes = shared_numbers(launch.method, launch.capacity) * sizeof(Scalar);
      if (launch.kind == Launch::Kind::LongVertices) scratch_bytes = std::max(scratch_bytes, launch.blocks * bytes);
      if (launch.kind == Launch::Kind::Vertices) {
        report_.local_bytes = std::max<std::uint64_t>(report_.local_bytes, bytes);
      }
    }
  }
  scratch_ = make_buffer(scratch_bytes, nullptr);
}

// Memory that the driver has pinned: what is read into it comes at full speed, while the CPU does something else.
// Without it positions come all the same.
template <class Scalar>
void Implementation<Scalar>::make_landing() {
  const std::size_t bytes = sizeof(Eigen::Vector3f) * offset_.back();
  cl_int status = CL_SUCCESS;
  landing_ = Buffer(cl_.CreateBuffer(context_.get(), CL_MEM_ALLOC_HOST_PTR, bytes, nullptr, &status));
  if (status != CL_SUCCESS) return;
  void* const mapped = cl_.EnqueueMapBuffer(transfer_.get(), landing_.get(), CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0,
                                            bytes, 0, nullptr, nullptr, &status);
  if (status == CL_SUCCESS) landed_ = static_cast<Eigen::Vector3f*>(mapped);
}

template <class Scalar>
void Implementation<Scalar>::simulate(const Batch& batch, cl_mem state, cl_uint substeps) {
  const cl_uint swapped = swapped_;
  const auto width = static_cast<std::size_t>(strands_->width);
  for (const Launch& launch : batch.launches) {
    const Kernel* kernel = &advance_strands_;
    std::size_t local = item_group();
    std::size_t global = (launch.blocks * width + local - 1) / local * local;
    if (launch.kind == Launch::Kind::Strands) {
      set(*kernel, state, batch.blocks.get(), launch.which.get(), static_cast<cl_uint>(launch.blocks),
          region_reals_.get(), region_ints_.get(), substep_reals_.get(), substep_ints_.get(), spheres_.get(), substeps,
          swapped);
    } else {
      const bool is_long = launch.kind == Launch::Kind::LongVertices;
      kernel = &advance_vertices_.at({launch.kind, launch.method});
      // One size for all: some drivers compile anew for each.
      local = vertex_group();
      global = local * launch.blocks;
      const std::size_t numbers = shared_numbers(launch.method, launch.capacity);
      const auto capacity = static_cast<cl_uint>(launch.capacity);
      const auto common = [&](const auto&... rest) {
        set(*kernel, state, batch.blocks.get(), launch.which.get(), region_reals_.get(), region_ints_.get(),
            substep_reals_.get(), substep_ints_.get(), spheres_.get(), substeps, swapped, rest...);
      };
      if (is_long) {
        common(scratch_.get(), capacity, static_cast<cl_uint>(numbers));
      } else {
        common(LocalMemory{numbers * sizeof(Scalar)}, capacity, cl_uint{0});
      }
      report_.group_items = std::max(report_.group_items, local);
    }
    cl_event event = nullptr;
    check_opencl(
        cl_.EnqueueNDRangeKernel(compute_.get(), kernel->get(), 1, nullptr, &global, &local, 0, nullptr, &event),
        "run a kernel");
    events_.emplace_back(event);
  }
}

template <class Scalar>
void Implementation<Scalar>::gather(const Batch& batch, cl_mem state, cl_uint swapped) const {
  const Vec3<Scalar> origin = to_vec3<Scalar>(origin_->now());
  set(gather_, state, batch.blocks.get(), batch.targets.get(), swapped, origin.x, origin.y, origin.z, positions_.get(),
      not_finite_.get());
  const std::size_t global[] = {batch.block_count * static_cast<std::size_t>(strands_->width), 8};
  check_opencl(
      cl_.EnqueueNDRangeKernel(compute_.get(), gather_.get(), 2, nullptr, global, nullptr, 0, nullptr, nullptr),
      "run a kernel");
}

template <class Scalar>
void Implementation<Scalar>::clear_figures() const {
  static constexpr cl_float kNone[std::size(decltype(found_){})] = {};
  check_opencl(
      cl_.EnqueueWriteBuffer(compute_.get(), figures_.get(), CL_FALSE, 0, sizeof kNone, kNone, 0, nullptr, nullptr),
      "take data");
}

template <class Scalar>
void Implementation<Scalar>::measure(const Batch& batch, cl_mem state, cl_uint swapped) const {
  set(measure_, state, batch.blocks.get(), batch.targets.get(), swapped, spheres_.get(), sphere_begin_, sphere_count_,
      figures_.get());
  const std::size_t global[] = {batch.block_count * static_cast<std::size_t>(strands_->width), 8};
  check_opencl(
      cl_.EnqueueNDRangeKernel(compute_.get(), measure_.get(), 2, nullptr, global, nullptr, 0, nullptr, nullptr),
      "run a kernel");
}

template <class Scalar>
Figures Implementation<Scalar>::found_figures() const {
  return {found_[0], found_[1], found_[2]};
}

template <class Scalar>
Figures Implementation<Scalar>::measure_at_start(std::span<const Sphere> spheres) {
  check_measured(plan_);
  std::vector<Scalar> numbers;
  append_spheres<Scalar>(spheres, origin_->now(), numbers);
  spheres_ = make_buffer(numbers.size() * sizeof(Scalar), numbers.data(), CL_MEM_READ_ONLY);
  sphere_begin_ = 0;
  sphere_count_ = static_cast<cl_uint>(spheres.size());
  clear_figures();
  for (const Batch& batch : batches_) {
    cl_mem const state = report_.streamed ? streamed_state_.get() : batch.state.get();
    if (report_.streamed) {
      check_opencl(cl_.EnqueueWriteBuffer(compute_.get(), state, CL_FALSE, 0, batch.numbers * sizeof(Scalar),
                                          host_state_.data() + batch.first_number, 0, nullptr, nullptr),
                   "take data");
    }
    measure(batch, state, swapped_);
  }
  check_opencl(
      cl_.EnqueueReadBuffer(compute_.get(), figures_.get(), CL_TRUE, 0, sizeof found_, found_, 0, nullptr, nullptr),
      "hand back data");
  return found_figures();
}

// Hands a frame's input to the device and lets it begin.
template <class Scalar>
void Implementation<Scalar>::start(const FrameInput& input) {
  check_against_plan(plan_, input);
  std::vector<Scalar> region_reals;
  std::vector<cl_int> region_ints;
  for (const RegionParams& params : input.regions) {
    const RegionPlan& plan = plan_.regions[region_ints.size() / kRegionInts];
    const RegionStep<Scalar> step =
        region_step<Scalar>(params, plan, rest_weight_, input, substep_before_, options_.skip);
    Scalar reals[kRegionReals];
    reals[kKeepFirst] = step.keep_first;
    reals[kKeep] = step.keep;
    reals[kTensionFirst] = step.tension_first;
    std::copy(std::begin(step.gravity_h2), std::end(step.gravity_h2), reals + kGravityH2);
    std::copy(std::begin(step.support_h2), std::end(step.support_h2), reals + kSupportH2);
    reals[kH2] = step.h2;
    reals[kDragH2] = step.drag_h2;
    reals[kGlobalStiffness] = step.global_stiffness;
    reals[kStepRatio2] = step.step_ratio2;
    reals[kLocalStiffness] = step.local_stiffness;
    reals[kRodBendH2] = step.rod_bend_h2;
    reals[kRodTwistH2] = step.rod_twist_h2;
    reals[kRodStretchH2] = step.rod_stretch_h2;
    region_reals.insert(region_reals.end(), std::begin(reals), std::end(reals));
    cl_int ints[kRegionInts];
    ints[kSupported] = step.supported;
    ints[kWind] = step.wind;
    ints[kGlobalShape] = step.global_shape;
    ints[kLocalShape] = step.local_shape;
    ints[kLocalMethod] = step.local_method;
    ints[kLocalIterations] = step.local_iterations;
    ints[kReacts] = step.reacts;
    ints[kDirectLengths] = step.direct_lengths;
    ints[kLengthIterations] = step.length_iterations;
    ints[kRod] = step.rod;
    ints[kRodIterations] = step.rod_iterations;
    region_ints.insert(region_ints.end(), std::begin(ints), std::end(ints));
  }
  const FrameSteps<Scalar> steps = frame_steps<Scalar>(input, *origin_);
  std::vector<Scalar> substep_reals;
  std::vector<cl_int> substep_ints;
  for (const Substep<Scalar>& substep : steps.substeps) {
    substep_reals.insert(substep_reals.end(), std::begin(substep.rotation), std::end(substep.rotation));
    substep_reals.insert(substep_reals.end(), std::begin(substep.moves), std::end(substep.moves));
    substep_reals.insert(substep_reals.end(), std::begin(substep.moved_before), std::end(substep.moved_before));
    substep_reals.insert(substep_reals.end(), std::begin(substep.wind), std::end(substep.wind));
    substep_ints.push_back(static_cast<cl_int>((substep.spheres - steps.spheres.data()) / 4));
    substep_ints.push_back(substep.sphere_count);
  }
  const auto renew = [&](Buffer& buffer, const auto& content) {
    buffer = make_buffer(content.size() * sizeof(content[0]), content.data(), CL_MEM_READ_ONLY);
  };
  renew(region_reals_, region_reals);
  renew(region_ints_, region_ints);
  renew(substep_reals_, substep_reals);
  renew(substep_ints_, substep_ints);
  renew(spheres_, steps.spheres);
  sphere_begin_ = static_cast<cl_uint>(substep_ints.end()[-2]);
  sphere_count_ = static_cast<cl_uint>(substep_ints.end()[-1]);

  run_batches(static_cast<cl_uint>(steps.substeps.size()));
  substep_before_ = input.substep;
}

// A frame of all strands, then their positions in the order of the groom.
template <class Scalar>
void Implementation<Scalar>::run_batches(cl_uint substeps) {
  const bool ends_swapped = swapped_ != (substeps % 2 != 0);
  for (const Batch& batch : batches_) {
    if (!report_.streamed) {
      simulate(batch, batch.state.get(), substeps);
      continue;
    }
    Scalar* const home = host_state_.data() + batch.first_number;
    const std::size_t bytes = batch.numbers * sizeof(Scalar);
    cl_mem const state = streamed_state_.get();
    check_opencl(cl_.EnqueueWriteBuffer(compute_.get(), state, CL_FALSE, 0, bytes, home, 0, nullptr, nullptr),
                 "take data");
    simulate(batch, state, substeps);
    check_opencl(cl_.EnqueueReadBuffer(compute_.get(), state, CL_FALSE, 0, bytes, home, 0, nullptr, nullptr),
                 "hand back data");
    gather(batch, state, ends_swapped);
    if (measuring_) measure(batch, state, ends_swapped);
  }
  swapped_ = ends_swapped;
  check_opencl(cl_.Flush(compute_.get()), "start");
}

template <class Scalar>
void Implementation<Scalar>::count_kernel_time() {
  for (const Event& event : finishing_) {
    cl_ulong begin = 0, end = 0;
    if (cl_.GetEventProfilingInfo(event.get(), CL_PROFILING_COMMAND_START, sizeof begin, &begin, nullptr) ==
            CL_SUCCESS &&
        cl_.GetEventProfilingInfo(event.get(), CL_PROFILING_COMMAND_END, sizeof end, &end, nullptr) == CL_SUCCESS) {
      kernel_seconds_ += 1e-9 * static_cast<double>(end - begin);
    }
  }
  finishing_.clear();
}

template <class Scalar>
void Implementation<Scalar>::advance(const FrameInput& input, std::span<Eigen::Vector3f> out, Figures* figures,
                                     const Alongside& alongside) {
  if (!out.empty() && out.size() != offset_.back()) {
    throw std::invalid_argument("positions are asked for in a place that does not hold one for each vertex");
  }
  if (figures != nullptr) check_measured(plan_);
  try {
    run_frame(input, out, figures, alongside);
  } catch (...) {
    // Nothing may be written to `out` any more, which goes away now.
    cl_.Finish(compute_.get());
    cl_.Finish(transfer_.get());
    throw;
  }
}

template <class Scalar>
void Implementation<Scalar>::run_frame(const FrameInput& input, std::span<Eigen::Vector3f> out, Figures* figures,
                                       const Alongside& alongside) {
  if (next_failure_) std::rethrow_exception(std::exchange(next_failure_, nullptr));
  measuring_ = figures != nullptr;
  if (measuring_) clear_figures();
  if (!started_) start(input);
  started_ = false;
  std::swap(events_, finishing_);
  if (!report_.streamed) {
    for (const Batch& batch : batches_) {
      gather(batch, batch.state.get(), swapped_);
      if (measuring_) measure(batch, batch.state.get(), swapped_);
    }
  }
  if (measuring_) {
    check_opencl(
        cl_.EnqueueReadBuffer(compute_.get(), figures_.get(), CL_FALSE, 0, sizeof found_, found_, 0, nullptr, nullptr),
        "hand back data");
  }
  // The flag is read by the queue that computes, so it tells when positions are ready for the other one.
  cl_event event = nullptr;
  check_opencl(cl_.EnqueueReadBuffer(compute_.get(), not_finite_.get(), CL_FALSE, 0, sizeof found_not_finite_,
                                     &found_not_finite_, 0, nullptr, &event),
               "hand back data");
  const Event ready(event);
  check_opencl(cl_.Flush(compute_.get()), "start");
  // The device goes on with the next frame while the positions of this one travel. What fails there is that frame's.
  if (expected_ && !report_.streamed) {
    try {
      start(*expected_);
      started_ = true;
    } catch (...) {
      next_failure_ = std::current_exception();
    }
  }
  expected_.reset();
  Event here;
  const auto read_positions = [&](std::span<Eigen::Vector3f> to) {
    cl_event done = nullptr;
    cl_event const after = ready.get();
    check_opencl(cl_.EnqueueReadBuffer(transfer_.get(), positions_.get(), CL_FALSE, 0, to.size_bytes(),
                                       landed_ != nullptr ? landed_ : to.data(), 1, &after, &done),
                 "hand back data");
    here = Event(done);
    check_opencl(cl_.Flush(transfer_.get()), "start");
  };
  if (!out.empty()) read_positions(out);

  FirstException failure;
  if (alongside) {
#pragma omp parallel num_threads(options_.threads)
    failure.guard([&] {
      alongside(true);
      alongside(false);
    });
  }
  cl_event const waited[] = {ready.get(), here.get()};
  check_opencl(cl_.WaitForEvents(here ? 2 : 1, waited), "finish a frame");
  if (here) take_landed(out);
  if (figures != nullptr) *figures = found_figures();
  count_kernel_time();
  if (found_not_finite_ != 0) {
    std::vector<Eigen::Vector3f> positions;
    if (out.empty()) {
      positions.resize(offset_.back());
      out = positions;
      read_positions(out);
      check_opencl(cl_.Finish(transfer_.get()), "finish a frame");
      take_landed(out);
    }
    find_non_finite_in(out);
  }
  failure.rethrow();
}

template <class Scalar>
void Implementation<Scalar>::take_landed(std::span<Eigen::Vector3f> out) const {
  if (landed_ == nullptr) return;
#pragma omp parallel for num_threads(options_.threads)
  for (std::ptrdiff_t v = 0; v < static_cast<std::ptrdiff_t>(out.size()); ++v) {
    out[static_cast<std::size_t>(v)] = landed_[v];
  }
}

// The state on the host: `home`, or where it is kept anyway.
template <class Scalar>
void Implementation<Scalar>::fetch_state(LargeArray<Scalar>& home) const {
  if (started_) throw std::logic_error("the device is at work on the next frame already");
  if (report_.streamed) return;
  home = LargeArray<Scalar>(numbers_);
  for (const Batch& batch : batches_) {
    check_opencl(cl_.EnqueueReadBuffer(compute_.get(), batch.state.get(), CL_TRUE, 0, batch.numbers * sizeof(Scalar),
                                       home.data() + batch.first_number, 0, nullptr, nullptr),
                 "hand back data");
  }
}

template <class Scalar>
void Implementation<Scalar>::save(const Sink& out) const {
  LargeArray<Scalar> home;
  fetch_state(home);
  StrandBlocks<Scalar> blocks = *strands_;
  blocks.lay_out(plan_, scratch(), report_.streamed ? host_state_.data() : home.data());
  save_state(blocks, offset_, swapped_, *origin_, substep_before_, out);
}

template <class Scalar>
void Implementation<Scalar>::load(const Source& in) {
  LargeArray<Scalar> home;
  fetch_state(home);
  StrandBlocks<Scalar> blocks = *strands_;
  blocks.lay_out(plan_, scratch(), report_.streamed ? host_state_.data() : home.data());
  substep_before_ = load_state(blocks, offset_, *origin_, in);
  swapped_ = false;
  if (report_.streamed) return;
  for (const Batch& batch : batches_) {
    check_opencl(cl_.EnqueueWriteBuffer(compute_.get(), batch.state.get(), CL_TRUE, 0, batch.numbers * sizeof(Scalar),
                                        home.data() + batch.first_number, 0, nullptr, nullptr),
                 "take data");
  }
}

template <class Scalar>
void Implementation<Scalar>::find_non_finite_in(std::span<const Eigen::Vector3f> positions) {
  for (std::size_t strand = 0; strand + 1 < offset_.size(); ++strand) {
    // Free vertices first: a bad one spoils the pinned ones beside it.
    const std::size_t count = offset_[strand + 1] - offset_[strand];
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t vertex = (k + 2) % count;
      if (positions[offset_[strand] + vertex].allFinite()) continue;
      non_finite_ = NonFinite{strand, vertex, 0};
      for (const Placed<Scalar>& placed : strands_->blocks) {
        const auto first = strands_->strand_order.begin() + static_cast<std::ptrdiff_t>(placed.first);
        if (!placed.block.masked || std::find(first, first + placed.count, strand) == first + placed.count) continue;
        non_finite_->masked_to = static_cast<std::size_t>(placed.block.vertices);
      }
      return;
    }
  }
}

template <class Scalar>
template <class Out>
void Implementation<Scalar>::read_as(std::span<Out> out) const {
  if (started_) throw std::logic_error("the device is at work on the next frame already");
  using Component = typename Out::Scalar;
  const auto width = static_cast<std::size_t>(strands_->width);
  const Eigen::Vector3d& origin = origin_->now();
  std::vector<Scalar> copy;
  for (const Batch& batch : batches_) {
    const Scalar* state = nullptr;
    if (report_.streamed) {
      state = host_state_.data() + batch.first_number;
    } else {
      copy.resize(batch.numbers);
      check_opencl(cl_.EnqueueReadBuffer(compute_.get(), batch.state.get(), CL_TRUE, 0, batch.numbers * sizeof(Scalar),
                                         copy.data(), 0, nullptr, nullptr),
                   "hand back data");
      state = copy.data();
    }
    for (std::size_t b = 0; b < batch.block_count; ++b) {
      const Placed<Scalar>& placed = strands_->blocks[batch.first_block + b];
      const BlockRow& row_of_block = batch.rows[b];
      const uint at = swapped_ && !placed.block.rides ? row_of_block.previous : row_of_block.position;
      for (int lane = 0; lane < placed.count; ++lane) {
        const std::size_t strand = strands_->strand_order[placed.first + static_cast<std::size_t>(lane)];
        for (std::size_t v = offset_[strand]; v < offset_[strand + 1]; ++v) {
          const Scalar* const row = state + at + strands_->row_at(v - offset_[strand], lane);
          for (std::size_t axis = 0; axis < 3; ++axis) {
            out[v][static_cast<Eigen::Index>(axis)] =
                in_world<Component>(row[axis * width], origin[static_cast<Eigen::Index>(axis)]);
          }
        }
      }
    }
  }
}

}  // namespace

Mapping mapping_of(const RegionPlan& region, Mapping asked, std::size_t strands) {
  if (region.rod) return Mapping::Strands;
  if (region.local_shape && region.local_method == 4) return Mapping::Vertices;
  if (region.local_shape && region.local_method == 1) return Mapping::Strands;
  if (asked != Mapping::Auto) return asked;
  return strands >= kManyStrands ? Mapping::Strands : Mapping::Vertices;
}

std::unique_ptr<OpenCLSolver> make_opencl_solver(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head,
                                                 const Device& device, const OpenCLOptions& options) {
  if (options.precision == Precision::Double) {
    return std::make_unique<Implementation<double>>(groom, plan, head, device, options);
  }
  return std::make_unique<Implementation<float>>(groom, plan, head, device, options);
}

}  // namespace strandbake
