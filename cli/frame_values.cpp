#include "cli/frame_values.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace strandbake {

FrameValues::FrameValues(const CacheReader& cache, Coloring coloring, const std::filesystem::path& golden)
    : cache_(cache), coloring_(coloring), golden_path_(golden) {
  if (coloring != Coloring::Region) other_.resize(cache.vertex_count());
  if (coloring != Coloring::Error) return;
  golden_.emplace(golden);
  const CacheHeader &is = cache.header(), &was = golden_->header();
  if (is.offset != was.offset) {
    throw InputError(
        fmt::format("{}: has {} strands of {} vertices in all, the other cache {} of {}; only caches of the same "
                    "strands can be compared",
                    golden.string(), was.offset.size() - 1, was.offset.back(), is.offset.size() - 1, is.offset.back()));
  }
}

void FrameValues::read(std::size_t index, std::span<const Eigen::Vector3f> position, std::vector<float>& out) {
  const std::size_t count = position.size();
  out.assign(count, 0);
  switch (coloring_) {
    case Coloring::Region:
      return;
    case Coloring::Stretch: {
      const CacheHeader& header = cache_.header();
      for (std::size_t s = 0; s + 1 < header.offset.size(); ++s) {
        for (std::uint64_t v = header.offset[s]; v + 1 < header.offset[s + 1]; ++v) {
          const float rest = (header.rest_position[v + 1] - header.rest_position[v]).norm();
          if (!(rest >= 1e-5f)) continue;
          const float stretch = std::abs((position[v + 1] - position[v]).norm() / rest - 1);
          out[v] = std::max(out[v], stretch);
          out[v + 1] = std::max(out[v + 1], stretch);
        }
      }
      return;
    }
    case Coloring::Speed: {
      if (cache_.has_velocity()) {
        cache_.read_velocity(index, other_);
        for (std::size_t v = 0; v < count; ++v) out[v] = other_[v].norm();
        return;
      }
      if (cache_.frame_count() < 2) return;
      const std::size_t beside = index > 0 ? index - 1 : 1;
      cache_.read_position(beside, other_);
      const double seconds = std::abs(cache_.frame_number(index) - cache_.frame_number(beside)) / cache_.header().fps;
      const auto rate = static_cast<float>(1 / seconds);
      for (std::size_t v = 0; v < count; ++v) out[v] = rate * (position[v] - other_[v]).norm();
      return;
    }
    case Coloring::Error: {
      const int number = cache_.frame_number(index);
      std::size_t there = 0;
      while (there < golden_->frame_count() && golden_->frame_number(there) != number) ++there;
      if (there == golden_->frame_count())
        throw InputError(fmt::format("{}: has no frame {} to compare with", golden_path_.string(), number));
      golden_->read_position(there, other_);
      for (std::size_t v = 0; v < count; ++v) out[v] = (position[v] - other_[v]).norm();
      return;
    }
  }
}

std::string FrameValues::name() const {
  switch (coloring_) {
    case Coloring::Region:
      return "region";
    case Coloring::Stretch:
      return "stretch";
    case Coloring::Speed:
      return "speed";
    case Coloring::Error:
      return "distance to " + golden_path_.filename().string();
  }
  return {};
}

std::string FrameValues::text(double value) const {
  if (coloring_ == Coloring::Stretch) return fmt::format("{:.6g} %", 100 * value);
  return fmt::format("{:.6g} {}", value, coloring_ == Coloring::Speed ? "m/s" : "m");
}

double round_up_scale(double most) {
  if (!(most > 0)) return 1;
  double power = std::pow(10.0, std::floor(std::log10(most)));
  for (const double step : {1.0, 2.0, 5.0}) {
    if (step * power >= most) return step * power;
  }
  return 10 * power;
}

}  // namespace strandbake
