// What parallel regions share.
#pragma once

#include <atomic>
#include <exception>

namespace strandbake {

// An exception that leaves a parallel region ends the process. The first one waits here until the region is over.
class FirstException {
 public:
  template <class Work>
  void guard(const Work& work) noexcept {
    try {
      work();
    } catch (...) {
      if (!taken_.test_and_set()) exception_ = std::current_exception();
    }
  }
  // After the region.
  void rethrow() const {
    if (exception_) std::rethrow_exception(exception_);
  }

 private:
  std::atomic_flag taken_;
  std::exception_ptr exception_;
};

}  // namespace strandbake
