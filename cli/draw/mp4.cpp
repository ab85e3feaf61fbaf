#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <stdexcept>
#include <string>
#include <utility>

#include "cli/draw/clip.h"
#include "cli/draw/part_file.h"

namespace strandbake {
namespace {

class Mp4Writer : public ClipWriter {
 public:
  Mp4Writer(const std::filesystem::path& path, int width, int height, double fps)
      : file_(path), frame_bytes_(3 * static_cast<std::size_t>(width) * static_cast<std::size_t>(height)) {
    char rate[32];
    std::snprintf(rate, sizeof rate, "%.9g", fps);
    // A path that begins with "-" or has a ":" in it would mean something else to ffmpeg.
    std::array<std::string, 26> words = {"ffmpeg",
                                         "-hide_banner",
                                         "-loglevel",
                                         "error",
                                         "-y",
                                         "-f",
                                         "rawvideo",
                                         "-pix_fmt",
                                         "rgb24",
                                         "-s",
                                         std::to_string(width) + "x" + std::to_string(height),
                                         "-framerate",
                                         rate,
                                         "-i",
                                         "-",
                                         "-c:v",
                                         "libx264",
                                         "-crf",
                                         "16",
                                         "-pix_fmt",
                                         "yuv420p",
                                         "-movflags",
                                         "+faststart",
                                         "-f",
                                         "mp4",
                                         "file:" + file_.part().string()};
    std::array<char*, words.size() + 1> argv{};
    for (std::size_t k = 0; k < words.size(); ++k) argv[k] = words[k].data();

    // A socket rather than a pipe: writing to one that nobody reads any more need not raise a signal.
    std::array<int, 2> ends{};
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0) fail(std::strerror(errno));
    to_ffmpeg_ = ends[0];
    said_ = std::tmpfile();
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, ends[1], STDIN_FILENO);
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
    if (said_ != nullptr) posix_spawn_file_actions_adddup2(&actions, ::fileno(said_), STDERR_FILENO);
    // Ctrl-C is for us: ffmpeg ends when its input does.
    posix_spawnattr_t attributes;
    posix_spawnattr_init(&attributes);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
    const int error = ::posix_spawnp(&ffmpeg_, "ffmpeg", &actions, &attributes, argv.data(), environ);
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&actions);
    ::close(ends[1]);
    if (error == 0) return;
    ffmpeg_ = 0;
    release();
    if (error == ENOENT) {
      throw DiskError(path.string() +
                      ": an MP4 needs the program ffmpeg, which is not installed; a GIF or a PNG does not");
    }
    throw DiskError(path.string() + ": ffmpeg cannot be started: " + std::strerror(error));
  }
  ~Mp4Writer() override {
    if (ffmpeg_ != 0) ::kill(ffmpeg_, SIGKILL);
    wait();
    release();
  }

  void add(std::span<const std::uint8_t> rgb) override {
    if (rgb.size() != frame_bytes_) throw std::invalid_argument("a frame of an MP4 has another size than the first");
    while (!rgb.empty()) {
      const ssize_t sent = ::send(to_ffmpeg_, rgb.data(), rgb.size(), MSG_NOSIGNAL);
      if (sent < 0 && errno == EINTR) continue;
      if (sent < 0) end();  // it has died, and says why
      rgb = rgb.subspan(static_cast<std::size_t>(sent));
    }
  }

  void finish() override {
    ::close(std::exchange(to_ffmpeg_, -1));
    if (wait() != 0) end();
    file_.finish();
  }

 private:
  // Ends ffmpeg, and tells the last line that it has said.
  [[noreturn]] void end() {
    if (to_ffmpeg_ >= 0) ::close(std::exchange(to_ffmpeg_, -1));
    wait();
    std::string last;
    if (said_ != nullptr) {
      std::rewind(said_);
      std::array<char, 1024> line{};
      while (std::fgets(line.data(), line.size(), said_) != nullptr) {
        std::string text = line.data();
        while (!text.empty() && (text.back() == '\n' || text.back() == '\r')) text.pop_back();
        if (!text.empty()) last = text;
      }
    }
    fail(last.empty() ? "it ended with an error" : last.c_str());
  }

  [[noreturn]] void fail(const char* why) const {
    throw DiskError(file_.path().string() + ": ffmpeg cannot write the MP4: " + why);
  }

  // 0 where it has ended well, or before.
  int wait() {
    if (ffmpeg_ == 0) return 0;
    int status = 0;
    while (::waitpid(ffmpeg_, &status, 0) < 0 && errno == EINTR) {
    }
    ffmpeg_ = 0;
    return status;
  }

  void release() {
    if (to_ffmpeg_ >= 0) ::close(std::exchange(to_ffmpeg_, -1));
    if (said_ != nullptr) std::fclose(std::exchange(said_, nullptr));
  }

  PartFile file_;
  std::size_t frame_bytes_;
  pid_t ffmpeg_ = 0;
  int to_ffmpeg_ = -1;
  std::FILE* said_ = nullptr;  // what ffmpeg says
};

}  // namespace

std::unique_ptr<ClipWriter> make_mp4(const std::filesystem::path& path, int width, int height, double fps) {
  if (width < 2 || height < 2 || width % 2 != 0 || height % 2 != 0) {
    throw std::invalid_argument("an MP4 has an even number of pixels on each side, not " + std::to_string(width) +
                                " x " + std::to_string(height));
  }
  return std::make_unique<Mp4Writer>(path, width, height, fps);
}

}  // namespace strandbake
