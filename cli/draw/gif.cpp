#include <gif_lib.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <new>
#include <stdexcept>
#include <string>
#include <utility>

#include "cli/draw/clip.h"
#include "cli/draw/palette.h"
#include "cli/draw/part_file.h"

namespace strandbake {
namespace {

class GifWriter : public ClipWriter {
 public:
  GifWriter(const std::filesystem::path& path, int width, int height, double fps, std::span<const std::uint8_t> sample)
      : file_(path), width_(width), height_(height), fps_(fps), palette_(sample) {
    int error = 0;
    gif_ = EGifOpen(this, &GifWriter::write, &error);
    if (gif_ == nullptr) throw std::bad_alloc();
    try {
      std::array<GifColorType, 256> colors{};
      for (std::size_t k = 0; k < Palette::size; ++k) {
        const Rgb8& color = palette_.colors()[k];
        colors[k] = {color[0], color[1], color[2]};
      }
      ColorMapObject* const map = GifMakeMapObject(static_cast<int>(colors.size()), colors.data());
      if (map == nullptr) throw std::bad_alloc();
      EGifSetGifVersion(gif_, true);
      const int put = EGifPutScreenDesc(gif_, width, height, 8, 0, map);
      GifFreeMapObject(map);
      require(put);
      const std::array<GifByteType, 3> for_ever = {1, 0, 0};
      require(EGifPutExtensionLeader(gif_, APPLICATION_EXT_FUNC_CODE));
      require(EGifPutExtensionBlock(gif_, 11, "NETSCAPE2.0"));
      require(EGifPutExtensionBlock(gif_, static_cast<int>(for_ever.size()), for_ever.data()));
      require(EGifPutExtensionTrailer(gif_));
    } catch (...) {
      close();
      throw;
    }
  }
  ~GifWriter() override { close(); }

  void add(std::span<const std::uint8_t> rgb) override {
    std::vector<GifByteType> now(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_));
    if (rgb.size() != 3 * now.size()) throw std::invalid_argument("a frame of a GIF has another size than the first");
    for (std::size_t p = 0; p < now.size(); ++p) {
      now[p] = palette_.index({rgb[3 * p], rgb[3 * p + 1], rgb[3 * p + 2]}, static_cast<int>(p) % width_,
                              static_cast<int>(p) / width_);
    }
    // Only the part that has changed, and in it only what has changed.
    int left = 0, top = 0, right = width_, bottom = height_;
    std::vector<GifByteType> drawn = now;
    if (!before_.empty()) {
      left = width_, top = height_, right = 0, bottom = 0;
      for (int y = 0; y < height_; ++y) {
        for (int x = 0; x < width_; ++x) {
          const std::size_t p =
              static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(x);
          if (now[p] == before_[p]) {
            drawn[p] = as_before;
            continue;
          }
          left = std::min(left, x);
          right = std::max(right, x + 1);
          top = std::min(top, y);
          bottom = y + 1;
        }
      }
      if (right == 0) left = 0, top = 0, right = 1, bottom = 1;  // nothing at all: GIF wants a pixel
    }
    ++count_;
    const auto time = [this](double frame) { return std::lround(100 * frame / fps_); };
    GraphicsControlBlock control{};
    control.DisposalMode = DISPOSE_DO_NOT;
    control.DelayTime = static_cast<int>(std::clamp(time(count_) - time(count_ - 1), 1L, 65535L));
    control.TransparentColor = as_before;
    std::array<GifByteType, 4> bytes{};
    EGifGCBToExtension(&control, bytes.data());
    require(EGifPutExtension(gif_, GRAPHICS_EXT_FUNC_CODE, static_cast<int>(bytes.size()), bytes.data()));
    require(EGifPutImageDesc(gif_, left, top, right - left, bottom - top, false, nullptr));
    for (int y = top; y < bottom; ++y) {
      require(EGifPutLine(
          gif_, &drawn[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(left)],
          right - left));
    }
    before_ = std::move(now);
  }

  void finish() override {
    const int closed = EGifCloseFile(std::exchange(gif_, nullptr), nullptr);
    if (failure_) std::rethrow_exception(failure_);
    if (closed != GIF_OK) throw DiskError(file_.path().string() + ": cannot write the GIF");
    file_.finish();
  }

 private:
  static constexpr GifByteType as_before = 255;

  // An exception cannot cross giflib's own functions: it waits in failure_.
  static int write(GifFileType* gif, const GifByteType* bytes, int count) {
    auto* const self = static_cast<GifWriter*>(gif->UserData);
    try {
      self->file_.write(std::as_bytes(std::span(bytes, static_cast<std::size_t>(count))));
      return count;
    } catch (...) {
      self->failure_ = std::current_exception();
      return 0;
    }
  }

  void require(int result) {
    if (failure_) std::rethrow_exception(failure_);
    if (result != GIF_OK)
      throw DiskError(file_.path().string() + ": cannot encode the GIF: " + GifErrorString(gif_->Error));
  }

  void close() {
    if (gif_ != nullptr) EGifCloseFile(std::exchange(gif_, nullptr), nullptr);
  }

  PartFile file_;
  int width_, height_;
  double fps_;
  double count_ = 0;  // frames
  Palette palette_;
  GifFileType* gif_ = nullptr;
  std::vector<GifByteType> before_;
  std::exception_ptr failure_;
};

}  // namespace

std::unique_ptr<ClipWriter> make_gif(const std::filesystem::path& path, int width, int height, double fps,
                                     std::span<const std::uint8_t> sample) {
  if (width < 1 || height < 1 || width > 65535 || height > 65535) {
    throw std::invalid_argument("a GIF has 1 to 65535 pixels on each side, not " + std::to_string(width) + " x " +
                                std::to_string(height));
  }
  return std::make_unique<GifWriter>(path, width, height, fps, sample);
}

}  // namespace strandbake
