// What the readers and writers throw. A message is one sentence that already names the place and says what would do.
#pragma once

#include <stdexcept>
#include <string>
#include <vector>

namespace strandbake {

// A file that is missing, not what it should be, or says something impossible. The program ends with exit code 3.
class InputError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// A file that cannot be created, written or renamed. The program ends with exit code 5.
class DiskError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// Things that a person should hear about although the work goes on; one sentence each.
using Warnings = std::vector<std::string>;

}  // namespace strandbake
