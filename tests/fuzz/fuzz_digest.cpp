// Any bytes as a digest.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "formats/cache_digest.h"
#include "formats/error.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace strandbake;
  try {
    const CacheDigest digest = parse_digest(std::string(reinterpret_cast<const char*>(data), size), "a.digest");
    // What was read can be written, is then read as the same, and agrees with itself.
    const std::string text = digest_text(digest);
    const CacheDigest again = parse_digest(text, "again.digest");
    if (digest_text(again) != text) std::abort();
    const DigestComparison found = compare_digests(digest, again, {});
    if (!found.mismatches.empty() || found.frames.size() != digest.frames.size()) std::abort();
    for (const FrameAgreement& frame : found.frames)
      if (frame.at_least != 0 || frame.at_most != 0) std::abort();
  } catch (const InputError&) {
  }
  return 0;
}
