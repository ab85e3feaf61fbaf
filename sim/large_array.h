// Arrays of megabytes.
#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <new>
#include <utility>

namespace strandbake {

// Zeroed memory that costs nothing until it is touched, in large pages where the system has them: that saves thousands
// of page faults, and misses where what is used together lies far apart. T may be any type of which zeros are a value.
template <class T>
class LargeArray {
 public:
  LargeArray() = default;
  explicit LargeArray(std::size_t count) : bytes_(count * sizeof(T)) {
    if (bytes_ == 0) return;
    constexpr int kRead = PROT_READ | PROT_WRITE, kPrivate = MAP_PRIVATE | MAP_ANONYMOUS;
    memory_ = ::mmap(nullptr, bytes_, kRead, kPrivate, -1, 0);
    if (memory_ == MAP_FAILED) throw std::bad_alloc();
    ::madvise(memory_, bytes_, MADV_HUGEPAGE);
  }
  LargeArray(LargeArray&& other) noexcept { *this = std::move(other); }
  LargeArray& operator=(LargeArray&& other) noexcept {
    std::swap(memory_, other.memory_);
    std::swap(bytes_, other.bytes_);
    return *this;
  }
  ~LargeArray() {
    if (bytes_ != 0) ::munmap(memory_, bytes_);
  }
  T* data() const { return static_cast<T*>(memory_); }

 private:
  void* memory_ = nullptr;
  std::size_t bytes_ = 0;
};

}  // namespace strandbake
