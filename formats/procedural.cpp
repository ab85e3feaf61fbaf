// How a strand is made:
//   1. its root, the next point of a low-discrepancy sequence on a spherical cap that leans back from the face;
//   2. its path: a direction that starts along the normal and is steered, step by step, to where hair of the style goes
//      there (over the scalp, down, to the tie), never below a height of its own over the head;
//   3. locks: the path is drawn towards that of the nearest of the first few strands, the more the nearer to the tip;
//   4. the curl around the path, and a little wander;
//   5. its vertices: points of that curve one segment length apart, so that all segments of a strand are equal.
//
// Only + - * / sqrt, comparisons and integers reach a position, in an order that is written out, so every machine makes
// the same bytes. That is why this file has its own vectors, sine and random numbers.
#include "formats/procedural.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace strandbake {
namespace {

struct Vec {
  double x, y, z;
};
Vec operator+(Vec a, Vec b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
Vec operator-(Vec a, Vec b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
Vec operator*(double s, Vec a) {
  return {s * a.x, s * a.y, s * a.z};
}
double dot(Vec a, Vec b) {
  return (a.x * b.x + a.y * b.y) + a.z * b.z;
}
Vec cross(Vec a, Vec b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
double norm(Vec a) {
  return std::sqrt(dot(a, a));
}
// `otherwise` where a has no direction.
Vec unit(Vec a, Vec otherwise) {
  const double length = norm(a);
  return length > 1e-12 ? (1 / length) * a : otherwise;
}
// The part of a across the unit vector n.
Vec across(Vec a, Vec n) {
  return a - dot(a, n) * n;
}
Vec mix(Vec a, Vec b, double t) {
  return a + t * (b - a);
}

double clamp01(double t) {
  return t < 0 ? 0 : t > 1 ? 1 : t;
}
double smooth(double t) {
  return clamp01(t) * clamp01(t) * (3 - 2 * clamp01(t));
}

struct SineCosine {
  double sine, cosine;
};
// Of an angle in turns, |turns| < 1e15, to about 1e-13: Taylor series about the nearest quarter turn.
SineCosine sine_cosine(double turns) {
  constexpr double tau = 6.283185307179586;
  const double quarter = std::floor(4 * turns + 0.5);
  const double x = tau * (turns - 0.25 * quarter);
  const double x2 = x * x;
  const double s =
      x * (1 + x2 * (-1. / 6 + x2 * (1. / 120 + x2 * (-1. / 5040 + x2 * (1. / 362880 + x2 * (-1. / 39916800))))));
  const double c =
      1 + x2 * (-1. / 2 +
                x2 * (1. / 24 + x2 * (-1. / 720 + x2 * (1. / 40320 + x2 * (-1. / 3628800 + x2 * (1. / 479001600))))));
  switch (static_cast<std::int64_t>(quarter) & 3) {
    case 0:
      return {s, c};
    case 1:
      return {c, -s};
    case 2:
      return {-s, -c};
    default:
      return {-c, s};
  }
}

// The finisher of splitmix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014).
std::uint64_t scramble(std::uint64_t z) {
  z += 0x9e3779b97f4a7c15;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
  z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
  return z ^ (z >> 31);
}

// Random numbers that depend on seed, strand and purpose alone, in [0, 1).
enum class Purpose : std::uint64_t {
  ShiftU,
  ShiftV,
  Length,
  Height,
  Radius,
  Phase,
  Pace,
  Part,
  JitterX,
  JitterY,
  JitterZ,
  WanderU,
  WanderV,
  Count
};
double random(std::uint64_t seed, std::uint64_t strand, Purpose purpose) {
  const std::uint64_t bits = scramble(scramble(scramble(seed) ^ strand) ^ static_cast<std::uint64_t>(purpose));
  return static_cast<double>(bits >> 11) * 0x1p-53;
}

enum class Style { Straight, Wavy, Curly, Ponytail, Fur };

Style style_of(std::string_view name) {
  if (name == "straight") return Style::Straight;
  if (name == "wavy") return Style::Wavy;
  if (name == "curly") return Style::Curly;
  if (name == "ponytail") return Style::Ponytail;
  if (name == "fur") return Style::Fur;
  throw InputError(fmt::format("style \"{}\" is none of straight, wavy, curly, ponytail, fur", name));
}

// The scalp: a cap about an axis that leans back, from the hairline over the crown to the nape.
constexpr Vec scalp_axis = {0, 0.8, -0.6};
constexpr Vec scalp_side = {1, 0, 0};
constexpr Vec scalp_front = {0, 0.6, 0.8};
constexpr double scalp_edge = 0.2;  // cosine of the angle between axis and hairline
// Roots stand this much outside the head, so that rounding to float32 cannot sink one.
constexpr double root_radius = head_radius * (1 + 1e-6);

constexpr Vec down = {0, -1, 0};
constexpr Vec tie_center = {0, 0.036, -0.112};
constexpr Vec tie_direction = {0, 0.28, -0.96};
constexpr double tie_radius = 0.007;
constexpr Vec fur_way = {0, -0.6, -0.8};  // the lie of fur: to the back and down

struct Root {
  Vec normal;
  double u, v;  // map of the scalp: a disk in the unit square, the front towards v = 1
};

Root make_root(std::uint64_t seed, std::uint64_t strand) {
  // The R2 sequence: steps of 1/g and 1/g^2, where g^3 = g + 1.
  const auto index = static_cast<double>(strand);
  double a = random(seed, 0, Purpose::ShiftU) + index * 0.7548776662466927;
  double b = random(seed, 0, Purpose::ShiftV) + index * 0.5698402909980532;
  a -= std::floor(a);
  b -= std::floor(b);
  const SineCosine turn = sine_cosine(b);
  const double height = 1 - a * (1 - scalp_edge);
  const double radius = std::sqrt(1 - height * height);
  const double disk = 0.5 * std::sqrt(a);
  return {height * scalp_axis + (radius * turn.cosine) * scalp_side + (radius * turn.sine) * scalp_front,
          0.5 + disk * turn.cosine, 0.5 + disk * turn.sine};
}

// What a strand is given by chance and by its place.
struct Strand {
  Root root;
  double length;
  double height;  // over the head, where it lies on it
  double part;    // on which side of the parting it falls (the sign), and how hard it is combed there, up to 1
  Vec jitter;     // -1 .. 1
};

Strand make_strand(const ProceduralParams& params, Style style, std::uint64_t strand) {
  const auto any = [&](Purpose purpose) { return random(params.seed, strand, purpose); };
  Strand s{};
  s.root = make_root(params.seed, strand);
  s.length = params.length * (1 - params.length_variation * any(Purpose::Length));
  // Hair from further up lies on hair from further down.
  const double layer = (dot(s.root.normal, scalp_axis) - scalp_edge) / (1 - scalp_edge);
  s.height = style == Style::Ponytail ? 0.001 + 0.004 * any(Purpose::Height)
                                      : 0.0015 + 0.009 * layer + 0.004 * any(Purpose::Height);
  if (style == Style::Curly) s.height += params.curl_radius;
  const double x = s.root.normal.x + 0.04 * (any(Purpose::Part) - 0.5);
  s.part = (x < 0 ? -1 : 1) * (0.75 + 0.25 * std::abs(x) / (std::abs(x) + 0.03));
  s.jitter = {2 * any(Purpose::JitterX) - 1, 2 * any(Purpose::JitterY) - 1, 2 * any(Purpose::JitterZ) - 1};
  return s;
}

// The least distance from the middle of the head after s metres of a strand.
double floor_radius(const Strand& strand, double s) {
  return root_radius + strand.height * clamp01(s / 0.01);
}

using Path = std::vector<Vec>;

// Where hair that falls around the head goes at p: over the scalp to the sides and back, then down.
Vec falling(const Strand& strand, Vec p, Vec n) {
  const double front = n.z > 0 ? n.z : 0;
  const double top = (n.y > 0 ? n.y : 0) * clamp01(1 + 1.2 * n.z);  // the parting fades towards the back
  const Vec combed = {strand.part * (0.9 * top + 2 * front), -1, -1.3 * front};
  const double above = norm(p) - (head_radius + strand.height);
  const double lying = 1 - clamp01(above / 0.015);
  const double inward = dot(combed, n);
  const Vec way = inward < 0 ? combed - (lying * inward) * n : combed;
  return unit(mix(way, down, clamp01(above / 0.05)), down);
}

// `steps` equal steps of a strand's way, a third further than its length so that nothing later runs out of it.
Path make_path(const Strand& strand, Style style, std::size_t steps) {
  const Vec root_normal = strand.root.normal;
  const double ds = 1.3 * strand.length / static_cast<double>(steps);
  const Vec tie_offset = {2 * strand.root.u - 1, (2 * strand.root.v - 1) * 0.96, (2 * strand.root.v - 1) * 0.28};
  const Vec tie = tie_center + tie_radius * tie_offset;
  double behind_tie = -1;  // metres since the tie, negative before it

  Vec p = root_radius * root_normal;
  const Vec first_way = style == Style::Ponytail ? tie - p
                        : style == Style::Fur    ? fur_way
                                                 : falling(strand, p, root_normal);
  const Vec flat = unit(across(first_way, root_normal), scalp_side);
  const double lean = style == Style::Ponytail ? 1.2 : style == Style::Fur ? 0.6 : 0.5;
  Vec d = unit(root_normal + lean * flat + (style == Style::Fur ? 0.4 : 0.12) * strand.jitter, root_normal);

  Path path = {p};
  path.reserve(steps + 1);
  for (std::size_t step = 1; step <= steps; ++step) {
    const Vec n = unit(p, root_normal);
    Vec way = down;
    double bend = std::min(0.012, 0.2 * strand.length);  // the length over which the direction follows
    if (style == Style::Fur) {
      way = unit(n + 2.0 * across(fur_way, n), n);
      bend = strand.length;
    } else if (style != Style::Ponytail) {
      way = falling(strand, p, n);
    } else if (behind_tie < 0) {
      const Vec to_tie = tie - p;
      const double distance = norm(to_tie);
      const double inward = dot(to_tie, n);
      way = unit(inward < 0 ? across(to_tie, n) : to_tie, tie_direction);
      bend = std::min(0.01, 0.4 * distance);
      if (distance < 0.004 + ds) behind_tie = 0;
    } else {
      // Held by the tie for a moment, then falling and fanning out.
      const double held = 1 - smooth(behind_tie / 0.03);
      way = unit(mix(down + 0.14 * tie_offset + 0.05 * strand.jitter, tie_direction, held), down);
      bend = 0.008 + 0.03 * (1 - held);
      behind_tie += ds;
    }
    d = unit(mix(d, way, std::min(1.0, ds / bend)), d);
    p = p + ds * d;
    const double least = floor_radius(strand, static_cast<double>(step) * ds);
    if (const double r = norm(p); r < least) {
      const Vec out = unit(p, root_normal);
      p = least * out;
      if (dot(d, out) < 0) d = unit(across(d, out), d);
    }
    path.push_back(p);
  }
  return path;
}

// A smooth curve through the points of a path (Catmull-Rom), straight on beyond its end. `at` counts points.
Vec on_path(const Path& path, double at) {
  const std::size_t last = path.size() - 1;
  if (at >= static_cast<double>(last))
    return path[last] + (at - static_cast<double>(last)) * (path[last] - path[last - 1]);
  const auto k = static_cast<std::size_t>(at);
  const double t = at - static_cast<double>(k);
  const Vec p1 = path[k];
  const Vec p2 = path[k + 1];
  const Vec p0 = k > 0 ? path[k - 1] : p1 - (p2 - p1);
  const Vec p3 = k + 2 <= last ? path[k + 2] : p2 + (p2 - p1);
  const Vec a = 0.5 * (p2 - p0);
  const Vec b = 0.5 * (p3 - p1);
  return p1 + t * (a + t * ((3 * (p2 - p1) - (2 * a + b)) + t * ((a + b) - 2 * (p2 - p1))));
}

// A direction across the path at each of its points, carried along without twist.
Path make_sideways(const Path& path, Vec root_normal) {
  Vec u = unit(cross(scalp_axis, root_normal), scalp_side);
  Path sideways;
  sideways.reserve(path.size());
  for (std::size_t k = 0; k < path.size(); ++k) {
    const std::size_t from = k + 1 < path.size() ? k : k - 1;
    const Vec d = unit(path[from + 1] - path[from], root_normal);
    u = unit(across(u, d), cross(d, scalp_side));
    sideways.push_back(u);
  }
  return sideways;
}

class Generator {
 public:
  // `counts`: vertices of each strand.
  Generator(const ProceduralParams& params, std::vector<int> counts)
      : params_(params),
        counts_(std::move(counts)),
        style_(style_of(params.style)),
        steps_(std::max<std::size_t>(160, static_cast<std::size_t>(params.length / 0.002))) {
    // The sequence covers the scalp at any length, so its first strands are spread evenly: they lead the locks.
    const std::size_t locks = params.clump > 0 ? std::min<std::size_t>(1000, counts_.size() / 40) : 0;
    for (std::size_t lock = 0; lock < locks; ++lock) {
      leaders_.push_back(make_strand(params_, style_, lock));
      leader_paths_.push_back(make_path(leaders_.back(), style_, steps_));
    }
  }

  Groom make() const {
    Groom groom;
    std::uint64_t total = 0;
    for (const int count : counts_) total += static_cast<std::uint64_t>(count);
    groom.offset.reserve(counts_.size() + 1);
    groom.position.reserve(total);
    groom.root_uv.reserve(counts_.size());
    for (std::size_t strand = 0; strand < counts_.size(); ++strand) {
      add_strand(strand, counts_[strand], groom);
    }
    return groom;
  }

 private:
  // The leader of the strand's lock: the nearest on its side of the parting.
  std::optional<std::size_t> leader_of(const Strand& strand) const {
    std::optional<std::size_t> best;
    double best_cosine = -2;
    for (std::size_t lock = 0; lock < leaders_.size(); ++lock) {
      if (style_ != Style::Ponytail && leaders_[lock].part * strand.part < 0) continue;
      const double cosine = dot(leaders_[lock].root.normal, strand.root.normal);
      if (cosine > best_cosine) {
        best = lock;
        best_cosine = cosine;
      }
    }
    return best;
  }

  void add_strand(std::size_t index, int vertices, Groom& groom) const {
    const Strand strand = make_strand(params_, style_, index);
    const std::optional<std::size_t> leader = leader_of(strand);
    const auto chance = [&](Purpose purpose) { return random(params_.seed, index, purpose); };
    const auto lock_chance = [&](Purpose purpose) { return random(params_.seed, leader.value_or(index), purpose); };

    Path path = make_path(strand, style_, steps_);
    if (leader) {
      for (std::size_t k = 0; k < path.size(); ++k) {
        const double along = 1.3 * static_cast<double>(k) / static_cast<double>(steps_);
        path[k] = mix(path[k], leader_paths_[*leader][k], 0.85 * params_.clump * smooth(along));
      }
    }
    const Path sideways = make_sideways(path, strand.root.normal);

    const bool is_curled = style_ == Style::Wavy || style_ == Style::Curly || style_ == Style::Ponytail;
    const double radius = is_curled ? params_.curl_radius * (0.8 + 0.4 * lock_chance(Purpose::Radius)) : 0;
    const double turns = params_.curl_turns * (0.9 + 0.2 * lock_chance(Purpose::Pace));
    const double phase = lock_chance(Purpose::Phase) + 0.1 * chance(Purpose::Phase);
    const double wander_phase_u = chance(Purpose::WanderU);
    const double wander_phase_v = chance(Purpose::WanderV);
    // A helix uses its length up in going round: its axis is sqrt(L^2 - q^2) long, q = 2 pi r turns; a plane wave of
    // the same radius about half of q^2.
    const double round = 6.283185307179586 * radius * turns;
    const double used = style_ == Style::Curly ? round * round : 0.5 * round * round;
    const double whole = strand.length * strand.length;
    const double axis_length = std::sqrt(std::max(whole - used, 0.04 * whole));

    const double path_step = 1.3 * strand.length / static_cast<double>(steps_);
    const double fine = std::max({static_cast<double>(steps_), 2.0 * vertices, 24 * params_.curl_turns});
    const double fine_step = 1.3 * strand.length / fine;
    const Vec root = root_radius * strand.root.normal;

    // The curve after s metres of path.
    const auto curve = [&](double s) {
      const double at = s / path_step;
      const auto k = std::min(static_cast<std::size_t>(at), steps_ - 1);
      const Vec center = on_path(path, at);
      const Vec u = sideways[k];
      const Vec v = cross(unit(path[k + 1] - path[k], u), u);
      const double along = s / strand.length;
      const SineCosine turn = sine_cosine(phase + turns * s / axis_length);
      const double r = radius * smooth(s / (0.25 * strand.length));
      const double wander = 0.02 * strand.length * along;
      const double wander_u = wander * sine_cosine(wander_phase_u + 0.7 * along).sine;
      const double wander_v = wander * sine_cosine(wander_phase_v + 0.7 * along).sine;
      Vec p = center + (r * turn.cosine + wander_u) * u;
      p = p + ((style_ == Style::Curly ? r * turn.sine : 0) + wander_v) * v;
      const double least = floor_radius(strand, s);
      return norm(p) < least ? least * unit(p, strand.root.normal) : p;
    };

    // Vertices: walk along the curve, and set one wherever the distance to the last has grown to a segment.
    const double segment = strand.length / (vertices - 1);
    const auto add = [&](Vec p) {
      // Rounded to float32, the precision of .hair.
      groom.position.emplace_back(static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z));
    };
    Vec vertex = root;
    add(vertex);
    Vec from = root;
    int made = 1;
    for (double k = 1; made < vertices; ++k) {
      const Vec to = curve(k * fine_step);
      while (made < vertices && norm(to - vertex) >= segment) {
        // |from + t (to - from) - vertex| = segment; `from` is nearer than that, `to` is not.
        const Vec way = to - from;
        const Vec gap = from - vertex;
        const double a = dot(way, way);
        const double b = dot(way, gap);
        const double c = dot(gap, gap) - segment * segment;
        vertex = from + ((std::sqrt(std::max(b * b - a * c, 0.0)) - b) / a) * way;
        add(vertex);
        ++made;
        from = vertex;
      }
      from = to;
    }
    groom.offset.push_back(groom.offset.back() + static_cast<std::uint64_t>(vertices));
    groom.root_uv.emplace_back(static_cast<float>(strand.root.u), static_cast<float>(strand.root.v));
  }

  ProceduralParams params_;
  std::vector<int> counts_;
  Style style_;
  std::size_t steps_;  // of a path
  std::vector<Strand> leaders_;
  std::vector<Path> leader_paths_;
};

// Visitor of fields(): throws where a value is outside its range.
struct RequireInRange {
  void operator()(std::string_view, const std::string& value, const Text&, const char*, const char*) {
    style_of(value);
  }
  template <class Number>
  void operator()(std::string_view name, const Number& value, const Range& range, const char*, const char*) {
    if (!range.contains(static_cast<double>(value))) {
      throw InputError(fmt::format("{} = {} is outside its range, {} to {}", name, value, range.low, range.high));
    }
  }
};

// Counts that differ by up to a quarter of their mean and add up to `total`. Neighbours differ by opposite amounts.
std::vector<int> mixed_counts(std::uint64_t strands, std::uint64_t total, std::uint64_t seed) {
  const auto spread = static_cast<double>(total / strands / 4 + 1);
  std::vector<int> counts;
  counts.reserve(strands);
  for (std::uint64_t strand = 0; strand < strands; ++strand) {
    const auto even = static_cast<int>((strand + 1) * total / strands - strand * total / strands);
    const bool has_partner = (strand | 1) < strands;
    const auto change = has_partner ? static_cast<int>(spread * random(seed, strand / 2, Purpose::Count)) : 0;
    counts.push_back(strand % 2 == 0 ? even + change : even - change);
  }
  return counts;
}

}  // namespace

ProceduralParams style_defaults(std::string_view name) {
  ProceduralParams params;
  params.style = name;
  switch (style_of(name)) {
    case Style::Straight:
    case Style::Wavy:
      break;
    case Style::Curly:
      params.vertices = 64;
      params.curl_radius = 0.005;
      params.curl_turns = 6;
      break;
    case Style::Ponytail:
      params.length = 0.4;
      params.curl_turns = 2;
      break;
    case Style::Fur:
      params.vertices = 8;
      params.length = 0.02;
      params.length_variation = 0.3;
      params.clump = 0.2;
      break;
  }
  return params;
}

Groom make_groom(const ProceduralParams& params) {
  RequireInRange check;
  ProceduralParams checked = params;
  fields(check, checked);
  const std::uint64_t total =
      static_cast<std::uint64_t>(checked.strands) * static_cast<std::uint64_t>(checked.vertices);
  if (total > std::numeric_limits<std::uint32_t>::max()) {
    throw InputError(
        fmt::format("{} strands of {} vertices are more than 4294967295 vertices, the most that a .hair file "
                    "can hold",
                    checked.strands, checked.vertices));
  }
  return Generator(checked, std::vector<int>(static_cast<std::size_t>(checked.strands), checked.vertices)).make();
}

std::optional<Groom> make_preset(std::string_view name) {
  ProceduralParams params;
  std::uint64_t total = 0;
  if (name == "model1") {
    params = style_defaults("ponytail");
    params.strands = 19'776;
    total = 221'078;
  } else if (name == "model2") {
    params = style_defaults("wavy");
    params.strands = 20'000;
    total = 259'993;
  } else if (name == "model3") {
    params = style_defaults("curly");
    params.strands = 20'000;
    params.length = 0.35;
    params.curl_turns = 8;
    total = 1'373'047;
  } else {
    return std::nullopt;
  }
  return Generator(params, mixed_counts(static_cast<std::uint64_t>(params.strands), total, params.seed)).make();
}

}  // namespace strandbake
