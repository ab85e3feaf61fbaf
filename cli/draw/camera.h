// A perspective camera, and the box that it should see.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
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

class Camera {
 public:
  // Looks at the middle of `box` from just far enough for all of it to be inside the picture and its margin. The box
  // has the axes of the view (see robust_bounds), which fits hair closer than one with those of the world. An empty box
  // counts as a cube of 0.3 m at the origin, one without size as a small cube. Values of the view outside their ranges
  // are clamped. Throws std::invalid_argument where a side of the picture is not positive.
  Camera(const Eigen::AlignedBox3f& box, const View& view, int width, int height);

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
