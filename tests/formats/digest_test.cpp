#include "formats/digest.h"

#include <catch2/catch.hpp>
#include <filesystem>
#include <fstream>
#include <string>

#include "formats/error.h"

using namespace strandbake;

namespace {

std::string sha256_text(const std::string& text) {
  return sha256(std::as_bytes(std::span(text)));
}

}  // namespace

// The vectors are those of FIPS 180-2, appendix B.
TEST_CASE("sha256 gives the digests of the standard") {
  CHECK(sha256_text("") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  CHECK(sha256_text("abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  CHECK(sha256_text("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq") ==
        "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
  CHECK(sha256_text(std::string(1000000, 'a')) == "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST_CASE("the digest of a file is that of its bytes, over the edges of the blocks it is read in") {
  const auto path = std::filesystem::temp_directory_path() / "strandbake_digest_test.bin";
  for (const std::size_t size : {0, 1, 65535, 65536, 65537, 200000}) {
    std::string bytes(size, '\0');
    for (std::size_t k = 0; k < size; ++k) bytes[k] = static_cast<char>(k * 31 % 251);
    std::ofstream(path, std::ios::binary) << bytes;
    CHECK(sha256_file(path) == sha256_text(bytes));
  }
  std::filesystem::remove(path);
}

TEST_CASE("the digest of a file that cannot be read is refused with its name") {
  CHECK_THROWS_WITH(sha256_file("no/such/file"), Catch::Contains("no/such/file") && Catch::Contains("No such file"));
  CHECK_THROWS_AS(sha256_file("no/such/file"), InputError);
  CHECK_THROWS_AS(sha256_file(std::filesystem::temp_directory_path()), InputError);
}
