// Writes the sample cache for tests of other readers:
//   make_cache FILE STRANDS FIRST LAST [deflate=N] [precision=P] [threads=N] [velocity] [nostats] [end]
// where end is finish (default), leave (no finish) or kill (SIGKILL after the last frame).
#include <csignal>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <string>

#include "tests/formats/cache_sample.h"

int main(int argc, char** argv) {
  if (argc < 5) return 2;
  strandbake::CacheOptions options;
  std::string end = "finish";
  for (int k = 5; k < argc; ++k) {
    const std::string word = argv[k];
    const std::string value = word.substr(word.find('=') + 1);
    if (word.starts_with("deflate=")) {
      options.deflate = std::stoi(value);
    } else if (word.starts_with("precision=")) {
      options.precision = std::stod(value);
    } else if (word.starts_with("threads=")) {
      options.threads = std::stoi(value);
    } else if (word == "velocity") {
      options.velocity = true;
    } else if (word == "nostats") {
      options.stats = false;
    } else {
      end = word;
    }
  }
  try {
    const strandbake::CacheHeader header = strandbake::sample_header(std::stoull(argv[2]));
    strandbake::CacheWriter writer(argv[1], header, options);
    for (int number = std::stoi(argv[3]); number <= std::stoi(argv[4]); ++number)
      writer.write(strandbake::SampleFrame(header, options, number).frame);
    if (end == "kill") std::raise(SIGKILL);
    if (end == "finish") writer.finish();
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
  return 0;
}
