// A perspective camera, and the box that it should see.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <limits>
#include <span>

namespace strandbake {

// What is farther from the origin on any axis [m] flew away and is not drawn.
inline constexpr float farthest = 1e6f;

// Where the camera stands around what it looks at.
struct View {
  float azimuth_deg = 35;   // about +Y; 0 looks along -Z at the front, 90 along -X
  float elevation_deg = 8;  // above the horizon, -89 .. 89
  float fov_deg = 28;       // vertical opening, 1 .. 120
  float margin = 0.02f;     // share of the picture left free on each side, 0 .. 0.45

  // Rows: right, up, back (from the scene to the eye), in the world. Exactly the axes of a camera with this view.
  Eigen::Matrix3f axes() const;
};

// What a camera must have in its picture: any number of points, of many frames, then the place from which they just
// fit.
class Framing {
 public:
  // For pictures of this shape. Values of the view outside their ranges are clamped. Throws std::invalid_argument where
  // a side of the picture is not positive.
  Framing(const View& view, int width, int height);

  // All points but those far from the rest (see robust_bounds), each moved by -shift.
  void add(std::span<const Eigen::Vector3f> points, const Eigen::Vector3f& shift = Eigen::Vector3f::Zero());
  // An ellipsoid; the columns of `radii` lead from its middle to its surface.
  void add(const Eigen::Vector3f& middle, const Eigen::Matrix3f& radii);

  // The middle of what was added, in the world; the origin where there is nothing.
  Eigen::Vector3f middle() const;

 private:
  friend class Camera;
  void add_extent(const Eigen::Vector3f& middle, const Eigen::Matrix3f& radii);

  int width_, height_;
  Eigen::Matrix3f axes_;
  float focal_;
  Eigen::Vector2f free_;  // half sides of the picture less the margin [pixels]
  Eigen::AlignedBox3f bounds_;
  // How far things reach across the right, left, upper and lower plane that bound what is seen.
  Eigen::Vector4f reach_ = Eigen::Vector4f::Constant(-std::numeric_limits<float>::infinity());
};

class Camera {
 public:
  // From just far enough for everything to be inside the picture and its margin. With nothing in it a cube of 0.3 m at
  // the origin counts; what has no size counts as a small cube.
  explicit Camera(const Framing& framing);
  // A box along the axes of the view.
  Camera(const Eigen::AlignedBox3f& box, const View& view, int width, int height);
  // At `from`, looking at `at`, +Y upward; straight up or down, -Z or +Z is. Two places that are the same make it look
  // along -Z. Throws as Framing.
  Camera(const Eigen::Vector3f& from, const Eigen::Vector3f& at, float fov_deg, int width, int height);

  // The same, elsewhere.
  Camera moved(const Eigen::Vector3f& by) const;

  int width() const { return width_; }
  int height() const { return height_; }
  const Eigen::Vector3f& eye() const { return eye_; }
  // As View::axes().
  const Eigen::Matrix3f& axes() const { return axes_; }
  // Pixels that one metre covers at a depth of one metre.
  float focal() const { return focal_; }
  // Nothing nearer than this is drawn [m].
  float near_depth() const { return near_; }

  // Pixel x, y (0, 0 is the outer corner at the top left; a pixel's middle is at one half) and depth [m] along the
  // view.
  Eigen::Vector3f project(const Eigen::Vector3f& point) const;
  // Unit vector from the eye through a place in the picture.
  Eigen::Vector3f ray(float x, float y) const;

 private:
  int width_;
  int height_;
  float focal_;
  float near_;
  Eigen::Vector3f eye_;
  Eigen::Matrix3f axes_;
};

// The box, along the rows of `axes`, of all points but those far from the rest: on each of them, what lies more than
// three interquartile ranges (the widest of the three axes) outside the quartiles is left out, and so is everything
// non-finite. Empty where no point is left. Many frames: take the union.
Eigen::AlignedBox3f robust_bounds(std::span<const Eigen::Vector3f> points,
                                  const Eigen::Matrix3f& axes = Eigen::Matrix3f::Identity());

}  // namespace strandbake
