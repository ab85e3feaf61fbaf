// Owners of HDF5 identifiers, and what HDF5 says about its last failure. For the cache's own code only.
#pragma once

#include <hdf5.h>

#include <string>
#include <utility>

namespace strandbake {

template <herr_t (*close_id)(hid_t)>
class Hdf5Id {
 public:
  Hdf5Id() = default;
  explicit Hdf5Id(hid_t id) : id_(id) {}
  ~Hdf5Id() { close(); }
  Hdf5Id(Hdf5Id&& other) noexcept : id_(std::exchange(other.id_, H5I_INVALID_HID)) {}
  Hdf5Id& operator=(Hdf5Id&& other) noexcept {
    if (this != &other) {
      close();
      id_ = std::exchange(other.id_, H5I_INVALID_HID);
    }
    return *this;
  }

  operator hid_t() const { return id_; }
  // False where HDF5 refused, which counts for files that were written.
  bool close() { return id_ < 0 || close_id(std::exchange(id_, H5I_INVALID_HID)) >= 0; }

 private:
  hid_t id_ = H5I_INVALID_HID;
};

using Hdf5File = Hdf5Id<H5Fclose>;
using Hdf5Group = Hdf5Id<H5Gclose>;
using Hdf5Dataset = Hdf5Id<H5Dclose>;
using Hdf5Attribute = Hdf5Id<H5Aclose>;
using Hdf5Space = Hdf5Id<H5Sclose>;
using Hdf5Type = Hdf5Id<H5Tclose>;
using Hdf5List = Hdf5Id<H5Pclose>;

// HDF5 prints its errors to stderr unless told otherwise; this tells it otherwise while it lives, in its thread. At the
// end of the program HDF5 would also complain about what damaged files kept it from closing; we close what we opened.
class QuietHdf5 {
 public:
  QuietHdf5() {
    [[maybe_unused]] static const herr_t no_exit_handler = H5dont_atexit();  // counts before HDF5's first call only
    H5Eget_auto2(H5E_DEFAULT, &print_, &data_);
    H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  }
  ~QuietHdf5() { H5Eset_auto2(H5E_DEFAULT, print_, data_); }
  QuietHdf5(const QuietHdf5&) = delete;
  QuietHdf5& operator=(const QuietHdf5&) = delete;

 private:
  H5E_auto2_t print_ = nullptr;
  void* data_ = nullptr;
};

// The innermost description on HDF5's error stack: the cause, not the call.
inline std::string hdf5_error() {
  std::string cause = "HDF5 gives no reason";
  H5Ewalk2(
      H5E_DEFAULT, H5E_WALK_UPWARD,
      [](unsigned n, const H5E_error2_t* entry, void* out) -> herr_t {
        if (n == 0 && entry->desc != nullptr) *static_cast<std::string*>(out) = entry->desc;
        return 0;
      },
      &cause);
  return cause;
}

}  // namespace strandbake
