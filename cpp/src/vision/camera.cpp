#include "soopnav/vision/camera.hpp"

#include <Eigen/LU>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>
#include <string>

namespace soopnav::vision {
namespace {

constexpr double kMostAngle = 89.0 * std::numbers::pi / 180.0;
constexpr double kLeastAngle = 0.01;
constexpr double kCloseEnoughPx = 1e-10;

std::size_t coefficients(Lens lens) { return lens == Lens::kPinhole ? 0 : lens == Lens::kRadialTangential ? 5 : 4; }

const char* name_of(Lens lens) {
  return lens == Lens::kPinhole ? "pinhole" : lens == Lens::kRadialTangential ? "radial-tangential" : "fisheye";
}

void need_size(const char* name, int value) {
  if (value >= 1 && value <= 65535) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; 1 to 65535 pixels are possible");
}

void need_finite(const char* name, double value) {
  if (std::isfinite(value)) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; a finite number is needed");
}

void need_positive(const char* name, double value) {
  need_finite(name, value);
  if (value > 0.0) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; it must be positive");
}

// Distorted radius of the angle t, without the tangential part, and its derivative by the angle.
struct Radius {
  double value, slope;
};

Radius radius(Lens lens, const std::array<double, 5>& k, double t) {
  if (lens == Lens::kFisheye) {
    const double s = t * t;
    return {t * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))),
            1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))};
  }
  const double r = std::tan(t), s = r * r;
  return {r * (1.0 + s * (k[0] + s * (k[1] + s * k[4]))),
          (1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * 7.0 * k[4]))) * (1.0 + s)};
}

// The angle up to which the distorted radius grows.
double growing_up_to(Lens lens, const std::array<double, 5>& k) {
  constexpr int kSteps = 4000;
  double low = 0.0;
  for (int i = 1; i <= kSteps; ++i) {
    double high = kMostAngle * i / kSteps;
    if (radius(lens, k, high).slope > 0.0) {
      low = high;
      continue;
    }
    for (int halving = 0; halving < 60; ++halving) {
      const double middle = 0.5 * (low + high);
      (radius(lens, k, middle).slope > 0.0 ? low : high) = middle;
    }
    return low;
  }
  return kMostAngle;
}

}  // namespace

Camera::Camera(int width, int height, double fx, double fy, double cx, double cy, Lens lens,
               std::span<const double> distortion)
    : width_(width), height_(height), fx_(fx), fy_(fy), cx_(cx), cy_(cy), lens_(lens) {
  need_size("width", width);
  need_size("height", height);
  need_positive("fx", fx);
  need_positive("fy", fy);
  need_finite("cx", cx);
  need_finite("cy", cy);
  const std::size_t wanted = coefficients(lens), given = distortion.size();
  if (given != 0 && given != wanted && !(lens == Lens::kRadialTangential && given == 4)) {
    throw std::invalid_argument("distortion: " + std::to_string(given) + " numbers; a " + name_of(lens) + " lens has " +
                                std::to_string(wanted));
  }
  for (std::size_t i = 0; i < given; ++i) {
    need_finite("distortion", distortion[i]);
    k_[i] = distortion[i];
  }
  max_angle_rad_ = growing_up_to(lens_, k_);
  if (max_angle_rad_ < kLeastAngle) {
    throw std::invalid_argument("distortion: beyond " + std::to_string(max_angle_rad_) +
                                " rad from the optical axis several rays share a pixel; at least 0.01 rad is needed");
  }
  max_radius_ = std::tan(max_angle_rad_);
  max_bent_ = radius(lens_, k_, max_angle_rad_).value;
}

std::span<const double> Camera::distortion() const noexcept { return {k_.data(), coefficients(lens_)}; }

Camera Camera::resized(int width, int height) const {
  need_size("width", width);
  need_size("height", height);
  const double along_u = static_cast<double>(width) / width_, along_v = static_cast<double>(height) / height_;
  return {width, height,      fx_ * along_u, fy_ * along_v, (cx_ + 0.5) * along_u - 0.5, (cy_ + 0.5) * along_v - 0.5,
          lens_, distortion()};
}

// Ray (a, b, 1) within max_angle_rad to pixel.
bool Camera::bend(double a, double b, Vector2& pixel, Eigen::Matrix2d* jacobian) const noexcept {
  const double s = a * a + b * b;
  if (!(s <= max_radius_ * max_radius_)) return false;  // also NaN
  double x = a, y = b;
  Eigen::Matrix2d M = Eigen::Matrix2d::Identity();
  if (lens_ == Lens::kRadialTangential) {
    const double g = 1.0 + s * (k_[0] + s * (k_[1] + s * k_[4]));
    const double dg = 2.0 * (k_[0] + s * (2.0 * k_[1] + s * 3.0 * k_[4]));  // by a: a * dg
    const double p1 = k_[2], p2 = k_[3];
    x = a * g + 2.0 * p1 * a * b + p2 * (s + 2.0 * a * a);
    y = b * g + p1 * (s + 2.0 * b * b) + 2.0 * p2 * a * b;
    if (jacobian != nullptr) {
      M(0, 0) = g + a * a * dg + 2.0 * p1 * b + 6.0 * p2 * a;
      M(0, 1) = a * b * dg + 2.0 * p1 * a + 2.0 * p2 * b;
      M(1, 0) = M(0, 1);
      M(1, 1) = g + b * b * dg + 6.0 * p1 * b + 2.0 * p2 * a;
    }
  } else if (lens_ == Lens::kFisheye) {
    const double r = std::sqrt(s), t = std::atan(r);
    const Radius bent = radius(lens_, k_, t);
    // Near the axis the bent radius is r + (k1 - 1/3) r^3.
    const bool near_axis = r < 1e-4;
    const double g = near_axis ? 1.0 + (k_[0] - 1.0 / 3.0) * s : bent.value / r;
    x = a * g;
    y = b * g;
    if (jacobian != nullptr) {
      const double dg = near_axis ? 2.0 * (k_[0] - 1.0 / 3.0) : (bent.slope / (1.0 + s) - g) / s;
      M << g + a * a * dg, a * b * dg, a * b * dg, g + b * b * dg;
    }
  }
  pixel = {fx_ * x + cx_, fy_ * y + cy_};
  if (jacobian != nullptr) {
    M.row(0) *= fx_;
    M.row(1) *= fy_;
    *jacobian = M;
  }
  return true;
}

// Newton's method on `bend`, from the radius alone; steps that leave the valid range or do not come closer are halved.
bool Camera::straighten(const Vector2& pixel, Vector2& ab, Eigen::Matrix2d& jacobian) const noexcept {
  const Vector2 bent((pixel.x() - cx_) / fx_, (pixel.y() - cy_) / fy_);
  const double radius_bent = bent.norm();
  if (!std::isfinite(radius_bent)) return false;
  if (lens_ == Lens::kPinhole) {
    ab = bent;
    jacobian << fx_, 0.0, 0.0, fy_;
    return radius_bent <= max_radius_;
  }
  // Tangential terms move the border a little.
  if (radius_bent > 1.2 * max_bent_ || (lens_ == Lens::kFisheye && radius_bent > max_bent_)) return false;
  double low = 0.0, high = max_angle_rad_, t = std::min(std::atan(radius_bent), max_angle_rad_);
  for (int step = 0; step < 60 && high - low > 1e-14; ++step) {
    const Radius at = radius(lens_, k_, t);
    (at.value < radius_bent ? low : high) = t;
    const double next = t - (at.value - radius_bent) / at.slope;
    const bool good = next > low && next < high;
    const double moved = good ? next : 0.5 * (low + high);
    const bool done = good && std::abs(moved - t) < 1e-15;
    t = moved;
    if (done) break;
  }
  Vector2 at = radius_bent > 0.0 ? Vector2(bent * (std::tan(t) / radius_bent)) : Vector2(0.0, 0.0);
  if (at.norm() > max_radius_) at *= max_radius_ * (1.0 - 1e-12) / at.norm();
  Vector2 seen;
  if (!bend(at.x(), at.y(), seen, &jacobian)) return false;
  double error = (seen - pixel).norm();
  for (int step = 0; step < 30 && error > kCloseEnoughPx; ++step) {
    Vector2 move = jacobian.inverse() * (pixel - seen);
    bool closer = false;
    for (int halving = 0; halving < 8 && !closer; ++halving, move *= 0.5) {
      const Vector2 next = at + move;
      Vector2 next_seen;
      Eigen::Matrix2d next_jacobian;
      if (!bend(next.x(), next.y(), next_seen, &next_jacobian)) continue;
      const double next_error = (next_seen - pixel).norm();
      closer = next_error < error;
      if (!closer) continue;
      at = next;
      seen = next_seen;
      jacobian = next_jacobian;
      error = next_error;
    }
    if (!closer) break;
  }
  if (!(error < 1e-6) || !(jacobian.determinant() > 0.0)) return false;
  ab = at;
  return true;
}

bool Camera::project(const Vector3& p_c, Vector2& pixel) const noexcept {
  if (!(p_c.z() > 0.0)) return false;
  return bend(p_c.x() / p_c.z(), p_c.y() / p_c.z(), pixel, nullptr);
}

bool Camera::project(const Vector3& p_c, Vector2& pixel, ProjectionJacobian& jacobian) const noexcept {
  if (!(p_c.z() > 0.0)) return false;
  const double a = p_c.x() / p_c.z(), b = p_c.y() / p_c.z();
  Eigen::Matrix2d M;
  if (!bend(a, b, pixel, &M)) return false;
  jacobian.leftCols<2>() = M / p_c.z();
  jacobian.col(2) = -(M.col(0) * a + M.col(1) * b) / p_c.z();
  return true;
}

bool Camera::unproject(const Vector2& pixel, Vector3& ray) const noexcept {
  Vector2 ab;
  Eigen::Matrix2d M;
  if (!straighten(pixel, ab, M)) return false;
  ray = {ab.x(), ab.y(), 1.0};
  return true;
}

bool Camera::unproject(const Vector2& pixel, Vector3& ray, UnprojectionJacobian& jacobian) const noexcept {
  Vector2 ab;
  Eigen::Matrix2d M;
  if (!straighten(pixel, ab, M)) return false;
  ray = {ab.x(), ab.y(), 1.0};
  jacobian.topRows<2>() = M.inverse();
  jacobian.row(2).setZero();
  return true;
}

}  // namespace soopnav::vision
