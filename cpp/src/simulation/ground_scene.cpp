#include "soopnav/simulation/ground_scene.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

namespace soopnav::simulation {

namespace {

constexpr float kGrey = 0.5F;
constexpr float kGrazing = 0.02F;  // n . r below which a pixel sees no ground

void require(bool holds, const char* name, double value, const char* rule) {
  if (!holds) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; it must be " + rule);
  }
}

void check_view(const CameraView& view) {
  require(std::isfinite(view.height_m) && view.height_m > 0.0, "height_m", view.height_m, "positive");
  require(std::isfinite(view.pose.x_m) && std::fabs(view.pose.x_m) < 1e6, "x_m", view.pose.x_m, "within 1000 km");
  require(std::isfinite(view.pose.y_m) && std::fabs(view.pose.y_m) < 1e6, "y_m", view.pose.y_m, "within 1000 km");
  require(std::isfinite(view.pose.heading_rad), "heading_rad", view.pose.heading_rad, "finite");
  require(std::fabs(view.tilt.a_x_rad) < 1.4, "a_x_rad", view.tilt.a_x_rad, "within 1.4");
  require(std::fabs(view.tilt.a_y_rad) < 1.4, "a_y_rad", view.tilt.a_y_rad, "within 1.4");
}

Eigen::Matrix2d turn(double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  Eigen::Matrix2d r;
  r << c, -s, s, c;
  return r;
}

double wrapped(double value, double period) { return value - period * std::floor(value / period); }

/// Where rays go in the ground frame: position of the camera and its axes.
struct Placed {
  explicit Placed(const CameraView& view, const Eigen::Vector3d& sensor_p_c = Eigen::Vector3d::Zero())
      : normal(vision::normal_of_tilt(view.tilt)) {
    const Eigen::Matrix3d body = vision::body_axes(normal);
    Eigen::Matrix3d heading = Eigen::Matrix3d::Identity();
    heading.topLeftCorner<2, 2>() = turn(view.pose.heading_rad);
    axes = heading * body;
    const Eigen::Vector3d lever = axes * sensor_p_c;
    position = Eigen::Vector3d(view.pose.x_m, view.pose.y_m, view.height_m) + lever;
  }
  Eigen::Vector3d normal;    // into the ground, camera axes
  Eigen::Matrix3d axes;      // camera to ground frame
  Eigen::Vector3d position;  // of the camera, ground frame
};

/// A row of noise of one octave: quadratic B-spline doubling of a periodic image, (1 3 3 1) / 4 along each side.
void doubled(std::vector<float>& image, int size, std::vector<float>& out) {
  const auto n = static_cast<std::size_t>(size);
  std::vector<float> wide(2 * n * n);
  for (std::size_t y = 0; y < n; ++y) {
    const float* const in = &image[y * n];
    float* const to = &wide[y * 2 * n];
    for (std::size_t x = 0; x < n; ++x) {
      to[2 * x] = 0.25F * in[(x + n - 1) % n] + 0.75F * in[x];
      to[2 * x + 1] = 0.75F * in[x] + 0.25F * in[(x + 1) % n];
    }
  }
  out.resize(4 * n * n);
  for (std::size_t y = 0; y < n; ++y) {
    const float* const here = &wide[y * 2 * n];
    const float* const above = &wide[((y + n - 1) % n) * 2 * n];
    const float* const below = &wide[((y + 1) % n) * 2 * n];
    float* const first = &out[2 * y * 2 * n];
    float* const second = first + 2 * n;
    for (std::size_t x = 0; x < 2 * n; ++x) {
      first[x] = 0.25F * above[x] + 0.75F * here[x];
      second[x] = 0.75F * here[x] + 0.25F * below[x];
    }
  }
}

}  // namespace

vision::GroundPlane true_plane(const CameraView& view) {
  check_view(view);
  return vision::GroundPlane::known(vision::normal_of_tilt(view.tilt), view.height_m);
}

/// Rays to texels of the ground: u = (h0 . r) / (n . r) + u0, in texels of the finest level.
struct GroundScene::Ground {
  Ground(const Placed& placed, double plane_height, double texel_m, int size, double shift_texels = 0.0) {
    const double above = placed.position.z() - plane_height;
    const double scale = above / texel_m;
    // Ground point = position + (above / n . r) (axes r), and the foot's texel near the middle of one period.
    hx = (scale * placed.axes.row(0)).cast<float>();
    hy = (scale * placed.axes.row(1)).cast<float>();
    n = placed.normal.cast<float>();
    u0 = static_cast<float>(wrapped(placed.position.x() / texel_m + shift_texels, size));
    v0 = static_cast<float>(wrapped(placed.position.y() / texel_m + shift_texels, size));
    above_texels = scale;
  }
  Eigen::Vector3f hx, hy, n;
  float u0, v0;
  double above_texels;
};

GroundScene::GroundScene(std::uint64_t seed, const GroundTextureOptions& options)
    : options_(options), random_(RandomStream(seed, 0x67726f756e64)) {
  const auto& o = options_;
  require(o.size >= 64 && o.size <= 8192 && (o.size & (o.size - 1)) == 0, "size", o.size,
          "a power of two in 64 ... 8192");
  require(std::isfinite(o.texel_m) && o.texel_m > 0.0, "texel_m", o.texel_m, "positive");
  require(o.finest_texels >= 1 && o.finest_texels <= o.size / 16 && (o.finest_texels & (o.finest_texels - 1)) == 0,
          "finest_texels", o.finest_texels, "a power of two of at most size / 16");
  require(o.roughness > 0.0 && o.roughness <= 2.0, "roughness", o.roughness, "in (0, 2]");
  require(o.contrast >= 0.0 && o.contrast <= 1.0, "contrast", o.contrast, "in [0, 1]");
  build(seed);
}

void GroundScene::build(std::uint64_t seed) {
  // Eq. 21: octaves of noise from 16 cells a side on, each coarser image doubled and the next added to it.
  RandomStream stream = RandomStream(seed, 0x74657874).substream(1);
  int size = 16;
  std::vector<float> image(256), next, noise;
  stream.fill_normal(std::span<float>(image));
  float amplitude = 1.0F;
  const int finest = options_.size / options_.finest_texels;
  while (size < options_.size) {
    doubled(image, size, next);
    size *= 2;
    image.swap(next);
    if (size > finest) continue;
    amplitude *= static_cast<float>(options_.roughness);
    noise.resize(image.size());
    stream.fill_normal(std::span<float>(noise));
    for (std::size_t i = 0; i < image.size(); ++i) image[i] += amplitude * noise[i];
  }
  double sum = 0.0, square = 0.0;
  for (const float value : image) {
    sum += static_cast<double>(value);
    square += static_cast<double>(value) * static_cast<double>(value);
  }
  const double mean = sum / static_cast<double>(image.size());
  const double spread = std::sqrt(std::max(square / static_cast<double>(image.size()) - mean * mean, 1e-12));
  const auto factor = static_cast<float>(options_.contrast / spread);
  for (float& value : image) {
    // A smooth limit in place of clipping, whose edges would alias.
    const float x = factor * (value - static_cast<float>(mean));
    value = kGrey + x / std::sqrt(1.0F + 4.0F * x * x);
  }
  texels_.clear();
  std::size_t start = 0;
  while (true) {
    levels_.push_back({start, size});
    texels_.insert(texels_.end(), image.begin(), image.end());
    start += image.size();
    if (size <= 8) break;
    const auto n = static_cast<std::size_t>(size), half = n / 2;
    next.resize(half * half);
    for (std::size_t y = 0; y < half; ++y) {
      for (std::size_t x = 0; x < half; ++x) {
        const float* const at = &image[2 * y * n + 2 * x];
        next[y * half + x] = 0.25F * (at[0] + at[1] + at[n] + at[n + 1]);
      }
    }
    image.swap(next);
    size /= 2;
  }
}

float GroundScene::sample(const Level& level, float u, float v) const noexcept {
  const int mask = level.size - 1;
  int iu = static_cast<int>(u), iv = static_cast<int>(v);
  iu -= static_cast<int>(static_cast<float>(iu) > u);
  iv -= static_cast<int>(static_cast<float>(iv) > v);
  const float fu = u - static_cast<float>(iu), fv = v - static_cast<float>(iv);
  const float* const texel = texels_.data() + level.start;
  const auto size = static_cast<std::size_t>(level.size);
  const std::size_t top = static_cast<std::size_t>(iv & mask) * size;
  const std::size_t bottom = static_cast<std::size_t>((iv + 1) & mask) * size;
  const auto left = static_cast<std::size_t>(iu & mask), right = static_cast<std::size_t>((iu + 1) & mask);
  const float above = texel[top + left] + fu * (texel[top + right] - texel[top + left]);
  const float below = texel[bottom + left] + fu * (texel[bottom + right] - texel[bottom + left]);
  return above + fv * (below - above);
}

double GroundScene::brightness(double x_m, double y_m) const noexcept {
  const double size = options_.size;
  return static_cast<double>(sample(levels_.front(), static_cast<float>(wrapped(x_m / options_.texel_m, size)),
                                    static_cast<float>(wrapped(y_m / options_.texel_m, size))));
}

void GroundScene::take_camera(const vision::Camera& camera) {
  std::array<double, 13> key{static_cast<double>(camera.width()),
                             static_cast<double>(camera.height()),
                             camera.fx(),
                             camera.fy(),
                             camera.cx(),
                             camera.cy(),
                             static_cast<double>(camera.lens())};
  std::copy(camera.distortion().begin(), camera.distortion().end(), key.begin() + 7);
  if (std::equal(key.begin(), key.end(), camera_.begin(), camera_.end())) return;
  width_ = camera.width();
  height_ = camera.height();
  focal_px_ = std::sqrt(camera.fx() * camera.fy());
  const std::size_t pixels = static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_);
  rays_.assign(2 * pixels, 0.0F);
  seen_.assign(pixels, 1);
  image_.assign(pixels, 0.0F);
  row_.assign(4 * static_cast<std::size_t>(width_), 0.0F);
  normals_.assign(static_cast<std::size_t>(width_), 0.0F);
  all_seen_ = true;
  std::size_t i = 0;
  for (int v = 0; v < height_; ++v) {
    for (int u = 0; u < width_; ++u, ++i) {
      Eigen::Vector3d ray;
      if (camera.unproject({u, v}, ray)) {
        rays_[i] = static_cast<float>(ray.x());
        rays_[pixels + i] = static_cast<float>(ray.y());
      } else {
        seen_[i] = 0;
        all_seen_ = false;
      }
    }
  }
  camera_.assign(key.begin(), key.end());
}

void GroundScene::add_row(const Ground& ground, int row, std::span<float> out) {
  const auto width = static_cast<std::size_t>(width_);
  const std::size_t pixels = width * static_cast<std::size_t>(height_);
  const float* const a = rays_.data() + static_cast<std::size_t>(row) * width;
  const float* const b = a + pixels;
  // The mip level follows the pixel's size on the ground in the middle of the row; finest detail has two pixels there.
  const std::size_t middle = width / 2;
  const double down = std::max(static_cast<double>(ground.n.x() * a[middle] + ground.n.y() * b[middle] + ground.n.z()),
                               static_cast<double>(kGrazing));
  const double footprint = ground.above_texels / (focal_px_ * down * std::sqrt(down));
  const double lod =
      std::clamp(std::log2(2.0 * footprint / options_.finest_texels), 0.0, static_cast<double>(levels_.size() - 1));
  const auto base = static_cast<std::size_t>(lod);
  const auto blend = static_cast<float>(lod - static_cast<double>(base));
  const Level& fine = levels_[base];
  const Level& coarse = levels_[std::min(base + 1, levels_.size() - 1)];
  const float shrink = 1.0F / static_cast<float>(1 << base);
  // Texel centres of a level lie half a texel off the finer one's.
  const float centre = 0.5F * shrink - 0.5F;
  float* const u = row_.data();
  float* const v = u + width;
  float* const w = v + width;
  bool open = all_seen_;
  float least = 1.0F;
  for (std::size_t i = 0; i < width; ++i) {
    const float n = ground.n.x() * a[i] + ground.n.y() * b[i] + ground.n.z();
    least = n < least ? n : least;
    const float inverse = 1.0F / (n > kGrazing ? n : kGrazing);
    w[i] = n;
    u[i] = ((ground.hx.x() * a[i] + ground.hx.y() * b[i] + ground.hx.z()) * inverse + ground.u0) * shrink + centre;
    v[i] = ((ground.hy.x() * a[i] + ground.hy.y() * b[i] + ground.hy.z()) * inverse + ground.v0) * shrink + centre;
  }
  open = open && least > kGrazing;
  if (blend > 0.0F) {
    for (std::size_t i = 0; i < width; ++i) {
      const float near = sample(fine, u[i], v[i]);
      const float far = sample(coarse, 0.5F * u[i] - 0.25F, 0.5F * v[i] - 0.25F);
      out[i] = near + blend * (far - near);
    }
  } else {
    for (std::size_t i = 0; i < width; ++i) out[i] = sample(fine, u[i], v[i]);
  }
  if (open) return;
  for (std::size_t i = 0; i < width; ++i) {
    if (!(w[i] > kGrazing) || seen_[static_cast<std::size_t>(row) * width + i] == 0) out[i] = kGrey;
  }
}

void GroundScene::add_objects(const CameraView& view, std::span<const GroundObject> objects, int row,
                              std::span<float> out) {
  const Placed placed(view);
  const auto width = static_cast<std::size_t>(width_);
  const std::size_t pixels = width * static_cast<std::size_t>(height_);
  const float* const a = rays_.data() + static_cast<std::size_t>(row) * width;
  const float* const b = a + pixels;
  for (const GroundObject& object : objects) {
    const double above = placed.position.z() - object.height_m;
    if (!(above > 0.0)) continue;
    const Eigen::Matrix2d into = turn(object.pose.heading_rad).transpose();
    const Eigen::Vector2d rest = into * (placed.position.head<2>() - Eigen::Vector2d(object.pose.x_m, object.pose.y_m));
    const Eigen::Matrix<float, 2, 3> map = (above * into * placed.axes.topRows<2>()).cast<float>();
    const Eigen::Vector2f from = rest.cast<float>();
    const Eigen::Vector3f n = placed.normal.cast<float>();
    const auto half_length = static_cast<float>(0.5 * object.length_m);
    const auto half_width = static_cast<float>(0.5 * object.width_m);
    const auto per_m = static_cast<float>(1.0 / options_.texel_m);
    const auto shift = static_cast<float>(object.texture_shift_m);
    const auto bright = static_cast<float>(object.brightness);
    for (std::size_t i = 0; i < width; ++i) {
      const float down = n.x() * a[i] + n.y() * b[i] + n.z();
      const float inverse = 1.0F / (down > kGrazing ? down : kGrazing);
      const float x = (map(0, 0) * a[i] + map(0, 1) * b[i] + map(0, 2)) * inverse + from.x();
      const float y = (map(1, 0) * a[i] + map(1, 1) * b[i] + map(1, 2)) * inverse + from.y();
      if (std::fabs(x) <= half_length && std::fabs(y) <= half_width && down > kGrazing &&
          seen_[static_cast<std::size_t>(row) * width + i] != 0) {
        out[i] = bright * sample(levels_.front(), (x + shift) * per_m, (y + shift) * per_m);
      }
    }
  }
}

void GroundScene::add_wall(const CameraView& view, const GroundWall& wall, int row, std::span<float> out) {
  const Placed placed(view);
  const Eigen::Vector3d across(std::cos(wall.heading_rad), std::sin(wall.heading_rad), 0.0);
  const Eigen::Vector3d along(-across.y(), across.x(), 0.0);
  const double gap = across.dot(Eigen::Vector3d(wall.x_m, wall.y_m, 0.0) - placed.position);
  const auto width = static_cast<std::size_t>(width_);
  const std::size_t first = static_cast<std::size_t>(row) * width;
  const std::size_t pixels = width * static_cast<std::size_t>(height_);
  for (std::size_t i = 0; i < width; ++i) {
    if (seen_[first + i] == 0) continue;
    const Eigen::Vector3d ray = placed.axes * Eigen::Vector3d(static_cast<double>(rays_[first + i]),
                                                              static_cast<double>(rays_[pixels + first + i]), 1.0);
    const double t = gap / across.dot(ray);
    const Eigen::Vector3d hit = placed.position + t * ray;
    if (!(t > 0.0) || !(hit.z() > 0.0)) continue;  // behind, or the ground comes first
    const double size = options_.size;
    out[i] = sample(levels_.front(), static_cast<float>(wrapped(along.dot(hit) / options_.texel_m, size)),
                    static_cast<float>(wrapped(hit.z() / options_.texel_m, size)));
  }
}

void GroundScene::defocus(double sigma_px) {
  const int radius = std::min(static_cast<int>(std::ceil(3.0 * sigma_px)), std::min(width_, height_) / 2 - 1);
  if (radius < 1) return;
  kernel_.resize(static_cast<std::size_t>(2 * radius + 1));
  float total = 0.0F;
  for (int k = -radius; k <= radius; ++k) {
    const auto at = static_cast<std::size_t>(k + radius);
    kernel_[at] = static_cast<float>(std::exp(-0.5 * k * k / (sigma_px * sigma_px)));
    total += kernel_[at];
  }
  for (float& value : kernel_) value /= total;
  const auto width = static_cast<std::size_t>(width_);
  const std::size_t pixels = width * static_cast<std::size_t>(height_);
  // Along rows into row_, then down columns with the last rows kept in order: the second half of image_ is scratch.
  image_.resize(2 * pixels);
  float* const middle = image_.data() + pixels;
  const auto clamped = [](int i, int n) { return static_cast<std::size_t>(std::clamp(i, 0, n - 1)); };
  for (int y = 0; y < height_; ++y) {
    const float* const in = image_.data() + static_cast<std::size_t>(y) * width;
    float* const out = middle + static_cast<std::size_t>(y) * width;
    for (int x = 0; x < width_; ++x) {
      float value = 0.0F;
      if (x >= radius && x + radius < width_) {
        for (int k = -radius; k <= radius; ++k) value += kernel_[static_cast<std::size_t>(k + radius)] * in[x + k];
      } else {
        for (int k = -radius; k <= radius; ++k) {
          value += kernel_[static_cast<std::size_t>(k + radius)] * in[clamped(x + k, width_)];
        }
      }
      out[x] = value;
    }
  }
  for (int y = 0; y < height_; ++y) {
    float* const out = image_.data() + static_cast<std::size_t>(y) * width;
    std::fill(out, out + width, 0.0F);
    for (int k = -radius; k <= radius; ++k) {
      const float weight = kernel_[static_cast<std::size_t>(k + radius)];
      const float* const in = middle + clamped(y + k, height_) * width;
      for (std::size_t x = 0; x < width; ++x) out[x] += weight * in[x];
    }
  }
}

void GroundScene::render(const vision::Camera& camera, std::span<const CameraView> views, const ShotOptions& shot,
                         std::span<const GroundObject> objects, const GroundWall* wall, std::span<std::uint8_t> image) {
  const std::size_t pixels = static_cast<std::size_t>(camera.width()) * static_cast<std::size_t>(camera.height());
  if (image.size() != pixels) {
    throw std::invalid_argument("image: " + std::to_string(image.size()) + " pixels; the camera has " +
                                std::to_string(pixels));
  }
  if (views.empty()) throw std::invalid_argument("views: none; at least one is needed");
  for (const CameraView& view : views) check_view(view);
  require(std::isfinite(shot.noise) && shot.noise >= 0.0, "noise", shot.noise, "at least 0");
  require(shot.defocus_px >= 0.0 && shot.defocus_px <= 50.0, "defocus_px", shot.defocus_px, "in 0 ... 50");
  require(std::isfinite(shot.gain) && std::isfinite(shot.offset) && std::isfinite(shot.gradient_x) &&
              std::isfinite(shot.gradient_y),
          "gain", shot.gain, "finite, as the offset and the gradients");
  take_camera(camera);
  const auto width = static_cast<std::size_t>(width_);
  const std::span<float> one(row_.data() + 3 * width, width);
  const float share = 1.0F / static_cast<float>(views.size());
  bool first = true;
  for (const CameraView& view : views) {
    const Placed placed(view);
    const Ground ground(placed, 0.0, options_.texel_m, options_.size);
    for (int row = 0; row < height_; ++row) {
      add_row(ground, row, one);
      if (wall != nullptr) add_wall(view, *wall, row, one);
      if (!objects.empty()) add_objects(view, objects, row, one);
      float* const to = image_.data() + static_cast<std::size_t>(row) * width;
      if (first) {
        for (std::size_t i = 0; i < width; ++i) to[i] = share * one[i];
      } else {
        for (std::size_t i = 0; i < width; ++i) to[i] += share * one[i];
      }
    }
    first = false;
  }
  if (shot.defocus_px > 0.0) defocus(shot.defocus_px);
  RandomStream stream = random_.substream(2 * shot.frame);
  const auto noise = static_cast<float>(shot.noise);
  for (int row = 0; row < height_; ++row) {
    const float* const from = image_.data() + static_cast<std::size_t>(row) * width;
    std::uint8_t* const to = image.data() + static_cast<std::size_t>(row) * width;
    if (noise > 0.0F) stream.fill_normal(std::span<float>(normals_.data(), width));
    const double down = height_ > 1 ? static_cast<double>(row) / (height_ - 1) - 0.5 : 0.0;
    const auto base = static_cast<float>(255.0 * shot.gain * (1.0 + shot.gradient_y * down));
    const auto slope = static_cast<float>(255.0 * shot.gain * shot.gradient_x / std::max(width_ - 1, 1));
    const auto offset = static_cast<float>(255.0 * shot.offset + 0.5);
    const float half = 0.5F * static_cast<float>(width_ - 1);
    for (std::size_t i = 0; i < width; ++i) {
      float value = from[i] * (base + slope * (static_cast<float>(i) - half)) + offset + noise * normals_[i];
      value = value > 0.0F ? value : 0.0F;
      value = value < 255.0F ? value : 255.0F;
      to[i] = static_cast<std::uint8_t>(static_cast<int>(value));
    }
  }
}

void GroundScene::depth_cloud(const vision::Camera& camera, const CameraView& view, const CloudOptions& options,
                              std::span<const GroundObject> objects, const GroundWall* wall, std::span<float> xyz) {
  check_view(view);
  const auto& o = options;
  if (xyz.size() != 3 * o.points) {
    throw std::invalid_argument("xyz: " + std::to_string(xyz.size()) + " numbers; three per point are " +
                                std::to_string(3 * o.points));
  }
  require(std::isfinite(o.sigma_m) && o.sigma_m >= 0.0, "sigma_m", o.sigma_m, "at least 0");
  require(std::isfinite(o.sigma_per_m) && o.sigma_per_m >= 0.0, "sigma_per_m", o.sigma_per_m, "at least 0");
  require(std::isfinite(o.quantum_per_m) && o.quantum_per_m >= 0.0, "quantum_per_m", o.quantum_per_m, "at least 0");
  require(o.hole_share >= 0.0 && o.hole_share <= 1.0, "hole_share", o.hole_share, "in [0, 1]");
  require(o.outlier_share >= 0.0 && o.outlier_share <= 1.0, "outlier_share", o.outlier_share, "in [0, 1]");
  require(o.sensor_p_c.allFinite(), "sensor_p_c", o.sensor_p_c.x(), "finite");
  take_camera(camera);
  const Placed placed(view, o.sensor_p_c);
  require(placed.position.z() > 0.0, "sensor_p_c", placed.position.z(), "above the ground");
  const std::size_t pixels = static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_);
  const double columns = std::max(1.0, std::round(std::sqrt(static_cast<double>(o.points) * width_ / height_)));
  const double rows = std::ceil(static_cast<double>(o.points) / columns);
  RandomStream stream = random_.substream(2 * o.frame + 1);
  draws_.resize(4 * o.points);
  normals_.resize(std::max(o.points, static_cast<std::size_t>(width_)));
  stream.fill_uniform(std::span<double>(draws_));
  stream.fill_normal(std::span<float>(normals_.data(), o.points));
  const Eigen::Vector3d across = wall == nullptr
                                     ? Eigen::Vector3d::Zero()
                                     : Eigen::Vector3d(std::cos(wall->heading_rad), std::sin(wall->heading_rad), 0.0);
  const double gap = wall == nullptr ? 0.0 : across.dot(Eigen::Vector3d(wall->x_m, wall->y_m, 0.0) - placed.position);
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  for (std::size_t i = 0; i < o.points; ++i) {
    const double* const draw = draws_.data() + 4 * i;
    const double cell = static_cast<double>(i);
    const double cell_row = std::floor(cell / columns);
    const auto at =
        std::min(static_cast<std::size_t>((cell_row + draw[1]) / rows * height_) * static_cast<std::size_t>(width_) +
                     static_cast<std::size_t>((cell - cell_row * columns + draw[0]) / columns * width_),
                 pixels - 1);
    const Eigen::Vector3d ray(static_cast<double>(rays_[at]), static_cast<double>(rays_[pixels + at]), 1.0);
    const double down = placed.normal.dot(ray);
    double z = down > 1e-3 ? placed.position.z() / down : 1e9;
    if (wall != nullptr) {
      const double t = gap / across.dot(placed.axes * ray);
      if (t > 0.0 && t < z) z = t;
    }
    for (const GroundObject& object : objects) {
      const double above = placed.position.z() - object.height_m;
      const double t = down > 1e-3 ? above / down : 1e9;
      if (!(above > 0.0) || !(t < z) || object.height_m <= 0.0) continue;
      const Eigen::Vector3d hit = placed.position + t * (placed.axes * ray);
      const Eigen::Vector2d inside = turn(object.pose.heading_rad).transpose() *
                                     (hit.head<2>() - Eigen::Vector2d(object.pose.x_m, object.pose.y_m));
      if (std::fabs(inside.x()) <= 0.5 * object.length_m && std::fabs(inside.y()) <= 0.5 * object.width_m) z = t;
    }
    // One draw decides between a hole, an outlier and a point.
    if (draw[2] < o.outlier_share) z *= 0.3 + 0.69 * draw[3];
    z += (o.sigma_m + o.sigma_per_m * z * z) * static_cast<double>(normals_[i]);
    if (o.quantum_per_m > 0.0) {
      const double steps = std::round(1.0 / (z * o.quantum_per_m));
      z = steps > 0.0 ? 1.0 / (steps * o.quantum_per_m) : 1e9;
    }
    const bool hole = draw[2] >= 1.0 - o.hole_share || seen_[at] == 0 || !(z > 0.0) || z > 1e4;
    xyz[3 * i] = hole ? kNan : static_cast<float>(ray.x() * z);
    xyz[3 * i + 1] = hole ? kNan : static_cast<float>(ray.y() * z);
    xyz[3 * i + 2] = hole ? kNan : static_cast<float>(z);
  }
}

}  // namespace soopnav::simulation
