// What verbs check before they begin.
#pragma once

#include <filesystem>

namespace CLI {
class Validator;
}

namespace strandbake {

// Throws DiskError where a file of this name must stay: there is one and `force` is not given, or it is no regular
// file, or it is `input`, which the verb reads.
void require_free(const std::filesystem::path& output, bool force, const std::filesystem::path& input = {});

// A number from `low` to `high`, and not NaN.
CLI::Validator number_between(double low, double high);

}  // namespace strandbake
