#include "soopnav/simulation/indoor_room.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <utility>

#include "simulation/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::simulation {
namespace {

using Complex = std::complex<double>;
constexpr double kSameLineM = 1e-9;
constexpr double kNearestM = 0.1;
constexpr double kDarkDb = 120.0;
constexpr int kMaxWalls = 64;
constexpr int kMaxOrder = 3;
constexpr int kMaxTail = 64;

struct Electric {
  double a, c, d;  // permittivity a, conductivity c f^d
};

// ITU-R P.2040-2, table 3; its exponent b is 0 for all of these.
constexpr Electric electric(Material material) noexcept {
  switch (material) {
    case Material::kConcrete:
      return {5.24, 0.0462, 0.7822};
    case Material::kBrick:
      return {3.91, 0.0238, 0.16};
    case Material::kPlaster:
      return {2.73, 0.0085, 0.9395};
    case Material::kWood:
      return {1.99, 0.0047, 1.0718};
    case Material::kGlass:
      return {6.31, 0.0036, 1.3394};
    case Material::kMetal:
      return {1.0, 1e7, 0.0};
  }
  return {1.0, 0.0, 0.0};
}

SlabResponse slab(Material material, double thickness_m, double cos_incidence, double frequency_hz, bool parallel) {
  const double ghz = frequency_hz * 1e-9;
  const Electric e = electric(material);
  const Complex eta{e.a, -17.98 * e.c * std::pow(ghz, e.d) / ghz};
  const double sin2 = 1.0 - cos_incidence * cos_incidence;
  const Complex root = std::sqrt(eta - sin2);
  const Complex face = parallel ? (eta * cos_incidence - root) / (eta * cos_incidence + root)
                                : (cos_incidence - root) / (cos_incidence + root);
  const double k = 2.0 * kPi * frequency_hz / kSpeedOfLightMps;
  const Complex once = std::exp(Complex(0.0, -k * thickness_m) * root);
  const Complex echoes = 1.0 - face * face * once * once;
  SlabResponse out;
  out.reflection = face * (1.0 - once * once) / echoes;
  const Complex air = std::polar(1.0, k * thickness_m * cos_incidence);
  out.transmission = (1.0 - face * face) * once / echoes * air;
  if (std::abs(out.transmission) > 1e-9) {
    out.delay_s = std::max(0.0, thickness_m / kSpeedOfLightMps * (root.real() - cos_incidence));
  }
  return out;
}

void tabulate(Material material, double thickness_m, double frequency_hz, bool parallel, std::span<SlabResponse> out) {
  const auto last = static_cast<double>(out.size() - 1);
  out[0] = {{-1.0, 0.0}, {0.0, 0.0}, 0.0};  // grazing
  for (std::size_t i = 1; i < out.size(); ++i) {
    out[i] = slab(material, thickness_m, static_cast<double>(i) / last, frequency_hz, parallel);
  }
}

SlabResponse look_up(std::span<const SlabResponse> table, double cos_incidence) noexcept {
  const double at = std::clamp(cos_incidence, 0.0, 1.0) * static_cast<double>(table.size() - 1);
  const std::size_t i = std::min(static_cast<std::size_t>(at), table.size() - 2);
  const double w = at - static_cast<double>(i);
  const SlabResponse& a = table[i];
  const SlabResponse& b = table[i + 1];
  return {(1.0 - w) * a.reflection + w * b.reflection, (1.0 - w) * a.transmission + w * b.transmission,
          (1.0 - w) * a.delay_s + w * b.delay_s};
}

double decibels_of(double ratio) noexcept { return 10.0 * std::log10(ratio); }

std::uint64_t bits_of(double value) noexcept { return std::bit_cast<std::uint64_t>(value + 0.0); }

}  // namespace

SlabResponse slab_response(Material material, double thickness_m, double cos_incidence, double frequency_hz,
                           bool parallel) {
  require(std::isfinite(thickness_m) && thickness_m > 0.0, "thickness_m", thickness_m, "it must be positive");
  require(cos_incidence > 0.0 && cos_incidence <= 1.0, "cos_incidence", cos_incidence, "it must be in (0, 1]");
  require(std::isfinite(frequency_hz) && frequency_hz > 0.0, "frequency_hz", frequency_hz, "it must be positive");
  return slab(material, thickness_m, cos_incidence, frequency_hz, parallel);
}

std::vector<Wall> rectangle_walls(double width_m, double depth_m, Material material, double thickness_m) {
  require(std::isfinite(width_m) && width_m > 0.0, "width_m", width_m, "it must be positive");
  require(std::isfinite(depth_m) && depth_m > 0.0, "depth_m", depth_m, "it must be positive");
  const Eigen::Vector2d a(0.0, 0.0), b(width_m, 0.0), c(width_m, depth_m), d(0.0, depth_m);
  return {{a, b, material, thickness_m},
          {b, c, material, thickness_m},
          {c, d, material, thickness_m},
          {d, a, material, thickness_m}};
}

std::vector<Wall> with_opening(const Wall& wall, double start_m, double stop_m, Material material, double thickness_m) {
  const double length = (wall.to_m - wall.from_m).norm();
  require(start_m >= 0.0 && start_m < stop_m, "start_m", start_m, "it must be 0 or more, and below stop_m");
  require(stop_m <= length * (1.0 + 1e-12), "stop_m", stop_m, "it must be at most the wall's length");
  const Eigen::Vector2d along = (wall.to_m - wall.from_m) / length;
  const Eigen::Vector2d a = wall.from_m + start_m * along;
  const Eigen::Vector2d b = stop_m < length ? Eigen::Vector2d(wall.from_m + stop_m * along) : wall.to_m;
  std::vector<Wall> out;
  if (start_m > 0.0) out.push_back({wall.from_m, a, wall.material, wall.thickness_m});
  out.push_back({a, b, material, thickness_m});
  if (stop_m < length) out.push_back({b, wall.to_m, wall.material, wall.thickness_m});
  return out;
}

// A straight piece of a path in the plan; `s` counts the share of the whole path's plan length from the receiver.
struct IndoorRoom::Leg {
  double ax, ay, bx, by;
  double sa, sb;
  int line_a, line_b;  // lines of the walls it starts and ends on, -1 for none
};

// Height along the path: straight, or folded once at floor or ceiling; and how steep it is.
struct IndoorRoom::Profile {
  double z_receiver, z_node, height;
  int vertical;
  double horizontal_share;  // plan length over length

  [[nodiscard]] double at(double s) const noexcept {
    switch (vertical) {
      case 1:
        return std::abs(z_receiver - s * (z_receiver + z_node));
      case 2:
        return height - std::abs(height - z_receiver - s * (2.0 * height - z_receiver - z_node));
      default:
        return z_receiver + s * (z_node - z_receiver);
    }
  }
};

IndoorRoom::IndoorRoom(std::vector<Wall> walls, const IndoorRoomOptions& options)
    : walls_(std::move(walls)), options_(options) {
  const auto& o = options_;
  require(!walls_.empty() && walls_.size() <= kMaxWalls, "walls", static_cast<double>(walls_.size()),
          "1 to 64 walls are needed");
  require(std::isfinite(o.carrier_hz) && o.carrier_hz >= 1e8 && o.carrier_hz <= 1e11, "carrier_hz", o.carrier_hz,
          "it must be in 0.1 ... 100 GHz");
  require(o.order >= 0 && o.order <= kMaxOrder, "order", o.order, "it must be 0 ... 3");
  require(std::isfinite(o.height_m) && o.height_m > 0.0, "height_m", o.height_m, "it must be positive");
  require(std::isfinite(o.floor_thickness_m) && o.floor_thickness_m > 0.0, "floor_thickness_m", o.floor_thickness_m,
          "it must be positive");
  require(o.path_range_db > 0.0 && std::isfinite(o.path_range_db), "path_range_db", o.path_range_db,
          "it must be positive");
  require(o.detect_range_db > 0.0 && o.detect_range_db <= o.path_range_db, "detect_range_db", o.detect_range_db,
          "it must be positive and at most path_range_db");
  require(std::isfinite(o.los_loss_db) && o.los_loss_db >= 0.0, "los_loss_db", o.los_loss_db, "it must be 0 or more");
  require(!std::isnan(o.tail_db) && o.tail_db <= 30.0, "tail_db", o.tail_db, "it must be at most 30 dB");
  require(std::isfinite(o.tail_decay_s) && o.tail_decay_s > 0.0, "tail_decay_s", o.tail_decay_s, "it must be positive");
  require(std::isfinite(o.tail_spacing_s) && o.tail_spacing_s > 0.0, "tail_spacing_s", o.tail_spacing_s,
          "it must be positive");
  require(o.tail_taps >= 0 && o.tail_taps <= kMaxTail, "tail_taps", o.tail_taps, "it must be 0 ... 64");
  lambda_m_ = kSpeedOfLightMps / o.carrier_hz;
  box_[0] = box_[2] = std::numeric_limits<double>::infinity();
  box_[1] = box_[3] = -std::numeric_limits<double>::infinity();
  planes_.resize(walls_.size());
  for (std::size_t i = 0; i < walls_.size(); ++i) {
    const Wall& wall = walls_[i];
    Plane& plane = planes_[i];
    const Eigen::Vector2d d = wall.to_m - wall.from_m;
    plane.length = d.norm();
    require(std::isfinite(plane.length) && plane.length > 1e-6, "walls", static_cast<double>(i),
            "this one has no length, or no finite one");
    require(std::isfinite(wall.thickness_m) && wall.thickness_m > 0.0, "thickness_m", wall.thickness_m,
            "it must be positive");
    plane.x = wall.from_m.x();
    plane.y = wall.from_m.y();
    plane.dx = d.x() / plane.length;
    plane.dy = d.y() / plane.length;
    plane.line = static_cast<int>(i);
    for (std::size_t j = 0; j < i; ++j) {
      const Plane& other = planes_[j];
      const double parallel = plane.dx * other.dy - plane.dy * other.dx;
      const double off = (plane.x - other.x) * other.dy - (plane.y - other.y) * other.dx;
      if (std::abs(parallel) < kSameLineM && std::abs(off) < kSameLineM) {
        plane.line = other.line;
        break;
      }
    }
    tabulate(wall.material, wall.thickness_m, o.carrier_hz, false, plane.slab);
    for (const Eigen::Vector2d& p : {wall.from_m, wall.to_m}) {
      box_[0] = std::min(box_[0], p.x());
      box_[1] = std::max(box_[1], p.x());
      box_[2] = std::min(box_[2], p.y());
      box_[3] = std::max(box_[3], p.y());
    }
  }
  tabulate(o.floor_material, o.floor_thickness_m, o.carrier_hz, true, floor_);
}

RoomNode IndoorRoom::node(const Eigen::Vector3d& position_m) const {
  require(position_m.allFinite(), "position_m", position_m.sum(), "it must be finite");
  RoomNode out;
  out.position_m_ = position_m;
  out.images_.push_back({position_m.x(), position_m.y(), -1, -1});
  for (std::size_t begin = 0, order = 0; order < static_cast<std::size_t>(options_.order); ++order) {
    const std::size_t end = out.images_.size();
    for (std::size_t i = begin; i < end; ++i) {
      for (std::size_t w = 0; w < planes_.size(); ++w) {
        const RoomNode::Image from = out.images_[i];
        const Plane& plane = planes_[w];
        if (from.wall >= 0 && planes_[static_cast<std::size_t>(from.wall)].line == plane.line) continue;
        const double off = (from.x - plane.x) * plane.dy - (from.y - plane.y) * plane.dx;
        if (std::abs(off) < kSameLineM) continue;
        out.images_.push_back(
            {from.x - 2.0 * off * plane.dy, from.y + 2.0 * off * plane.dx, static_cast<int>(w), static_cast<int>(i)});
      }
    }
    begin = end;
  }
  if (!(options_.tail_db > -300.0)) return out;
  RandomStream random = RandomStream(options_.seed, 0x1d00)
                            .substream(bits_of(position_m.x()))
                            .substream(bits_of(position_m.y()))
                            .substream(bits_of(position_m.z()));
  out.tail_.resize(static_cast<std::size_t>(options_.tail_taps));
  double sum = 0.0;
  for (std::size_t i = 0; i < out.tail_.size(); ++i) {
    RoomNode::TailTap& tap = out.tail_[i];
    tap.delay_s = (static_cast<double>(i) + 0.5 + random.uniform()) * options_.tail_spacing_s;
    tap.power = std::exp(-tap.delay_s / options_.tail_decay_s);
    sum += tap.power;
    for (std::size_t m = 0; m < RoomNode::kWaves; ++m) {
      // One direction per sector, so that no tap is carried by a few neighbouring ones.
      const double direction = 2.0 * kPi * (static_cast<double>(m) + random.uniform()) / double{RoomNode::kWaves};
      tap.kx[m] = 2.0 * kPi / lambda_m_ * std::cos(direction);
      tap.ky[m] = 2.0 * kPi / lambda_m_ * std::sin(direction);
      tap.phase[m] = 2.0 * kPi * random.uniform();
    }
  }
  for (RoomNode::TailTap& tap : out.tail_) tap.power /= sum;
  return out;
}

IndoorLink IndoorRoom::make_link() const {
  const std::size_t w = walls_.size();
  std::size_t images = 1;
  for (std::size_t order = 0, kind = 1; order < static_cast<std::size_t>(options_.order); ++order) {
    kind *= order == 0 ? w : w - 1;
    images += kind;
  }
  IndoorLink link;
  // Far fewer are ever seen from one place: each line of a path is met once by one of the walls on it.
  link.taps.reserve(std::min<std::size_t>(3 * images, 4096) + static_cast<std::size_t>(options_.tail_taps));
  return link;
}

void IndoorRoom::through(const Leg& leg, const Profile& profile, Complex& gain, double& delay_s) const noexcept {
  const double ex = leg.bx - leg.ax, ey = leg.by - leg.ay;
  const double plan = std::hypot(ex, ey);
  if (!(plan > 0.0)) return;
  for (const Plane& plane : planes_) {
    if (plane.line == leg.line_a || plane.line == leg.line_b) continue;
    const double cross = ex * plane.dy - ey * plane.dx;
    const double side_a = (leg.ax - plane.x) * plane.dy - (leg.ay - plane.y) * plane.dx;
    const double t = -side_a / cross;  // share of the leg; infinite or NaN when parallel: refused below
    if (!(t > 0.0 && t < 1.0)) continue;
    const double u = (leg.ax + t * ex - plane.x) * plane.dx + (leg.ay + t * ey - plane.y) * plane.dy;
    if (!(u >= 0.0 && u < plane.length)) continue;
    if (profile.at(leg.sa + t * (leg.sb - leg.sa)) > options_.height_m) continue;
    const SlabResponse slab = look_up(plane.slab, std::abs(cross) / plan * profile.horizontal_share);
    gain *= slab.transmission;
    delay_s += slab.delay_s;
  }
}

bool IndoorRoom::path(const RoomNode& node, std::size_t image, const Eigen::Vector3d& place_m, int vertical,
                      Tap& tap) const noexcept {
  const double h = options_.height_m;
  const double zr = place_m.z(), zt = node.position_m_.z();
  double rise = zt - zr;
  if (vertical == 1) rise = zt + zr;
  if (vertical == 2) rise = 2.0 * h - zt - zr;
  const RoomNode::Image& last = node.images_[image];
  const double plan = std::hypot(last.x - place_m.x(), last.y - place_m.y());
  const double length = std::hypot(plan, rise);
  const Profile profile{zr, zt, h, vertical, length > 0.0 ? plan / length : 1.0};
  const double bounce = vertical == 1 ? zr / rise : vertical == 2 ? (h - zr) / rise : -1.0;

  // Mirrors first: whether the path exists at all.
  struct Mirror {
    double x, y, s;
    const Plane* plane;
  };
  std::array<Mirror, kMaxOrder> mirrors;
  std::size_t n = 0;
  double px = place_m.x(), py = place_m.y(), s = 0.0;
  for (int i = static_cast<int>(image); node.images_[static_cast<std::size_t>(i)].wall >= 0;) {
    const RoomNode::Image& at = node.images_[static_cast<std::size_t>(i)];
    const Plane& plane = planes_[static_cast<std::size_t>(at.wall)];
    const double ex = at.x - px, ey = at.y - py;
    const double cross = ex * plane.dy - ey * plane.dx;
    const double t = -((px - plane.x) * plane.dy - (py - plane.y) * plane.dx) / cross;
    if (!(t > 0.0 && t < 1.0)) return false;
    const double x = px + t * ex, y = py + t * ey;
    const double u = (x - plane.x) * plane.dx + (y - plane.y) * plane.dy;
    if (!(u >= 0.0 && u < plane.length)) return false;
    s += t * (1.0 - s);
    const double z = profile.at(s);
    if (z > h || z < 0.0) return false;
    mirrors[n++] = {x, y, s, &plane};
    px = x;
    py = y;
    i = at.parent;
  }

  Complex gain = lambda_m_ / (4.0 * kPi * length);
  double delay_s = length / kSpeedOfLightMps;
  px = place_m.x();
  py = place_m.y();
  double sa = 0.0;
  int line = -1;
  for (std::size_t i = 0; i <= n; ++i) {
    const bool end = i == n;
    const Leg leg{px,
                  py,
                  end ? node.position_m_.x() : mirrors[i].x,
                  end ? node.position_m_.y() : mirrors[i].y,
                  sa,
                  end ? 1.0 : mirrors[i].s,
                  line,
                  end ? -1 : mirrors[i].plane->line};
    if (bounce >= leg.sa && bounce < leg.sb) {
      const double w = leg.sb > leg.sa ? (bounce - leg.sa) / (leg.sb - leg.sa) : 0.0;
      const double bx = leg.ax + w * (leg.bx - leg.ax), by = leg.ay + w * (leg.by - leg.ay);
      if (bx < box_[0] || bx > box_[1] || by < box_[2] || by > box_[3]) return false;
      gain *= look_up(floor_, rise / length).reflection;
    }
    through(leg, profile, gain, delay_s);
    if (end) break;
    const Plane& plane = *mirrors[i].plane;
    const double ex = leg.bx - leg.ax, ey = leg.by - leg.ay;
    const double cosine = std::abs(ex * plane.dy - ey * plane.dx) / std::hypot(ex, ey) * profile.horizontal_share;
    gain *= look_up(plane.slab, cosine).reflection;
    px = leg.bx;
    py = leg.by;
    sa = leg.sb;
    line = plane.line;
  }
  tap.delay_s = delay_s;
  tap.gain = gain * std::polar(1.0, -2.0 * kPi * std::fmod(length / lambda_m_, 1.0));
  return true;
}

void IndoorRoom::link(const RoomNode& node, const Eigen::Vector3d& place_m, IndoorLink& link) const {
  std::vector<Tap> taps = std::move(link.taps);  // keeps its room
  taps.clear();
  link = IndoorLink{};
  link.taps = std::move(taps);
  if (!place_m.allFinite()) {
    link.distance_m = link.wall_loss_db = link.power_db = link.excess_delay_s = std::nan("");
    return;
  }
  link.distance_m = (place_m - node.position_m_).norm();
  link.wall_loss_db = wall_loss_db(place_m, node.position_m_);
  link.line_of_sight = link.wall_loss_db <= options_.los_loss_db;
  link.power_db = -std::numeric_limits<double>::infinity();
  if (link.distance_m < kNearestM) {
    link.status = LinkStatus::kTooClose;
    return;
  }
  const bool inside = place_m.z() > 0.0 && place_m.z() < options_.height_m && node.position_m_.z() > 0.0 &&
                      node.position_m_.z() < options_.height_m;
  const int kinds = options_.floor_and_ceiling && inside ? 3 : 1;
  double strongest = 0.0;
  for (std::size_t i = 0; i < node.images_.size(); ++i) {
    for (int vertical = 0; vertical < kinds; ++vertical) {
      Tap tap;
      // A floor or ceiling bounce counts as one of the reflections.
      if (vertical > 0 && options_.order == 0) continue;
      if (!path(node, i, place_m, vertical, tap)) {
        if (vertical == 0) break;
        continue;
      }
      strongest = std::max(strongest, std::norm(tap.gain));
      link.taps.push_back(tap);
    }
  }
  const double free_space = lambda_m_ / (4.0 * kPi * link.distance_m);
  if (!(decibels_of(strongest) > 2.0 * decibels_of(free_space) - kDarkDb)) {
    link.taps.clear();
    link.status = LinkStatus::kDark;
    return;
  }
  const double least = strongest * std::pow(10.0, -0.1 * options_.path_range_db);
  std::erase_if(link.taps, [least](const Tap& tap) { return std::norm(tap.gain) < least; });
  double power = 0.0, first = std::numeric_limits<double>::infinity();
  for (const Tap& tap : link.taps) {
    power += std::norm(tap.gain);
    first = std::min(first, tap.delay_s);
  }
  link.paths = static_cast<int>(link.taps.size());
  if (!node.tail_.empty()) {
    const double tail = power * std::pow(10.0, 0.1 * options_.tail_db);
    for (const RoomNode::TailTap& tap : node.tail_) {
      double re = 0.0, im = 0.0;
      for (std::size_t m = 0; m < RoomNode::kWaves; ++m) {
        const double phase = tap.kx[m] * place_m.x() + tap.ky[m] * place_m.y() + tap.phase[m];
        re += std::cos(phase);
        im += std::sin(phase);
      }
      const double scale = std::sqrt(tail * tap.power / double{RoomNode::kWaves});
      link.taps.push_back({first + tap.delay_s, {scale * re, scale * im}});
      power += scale * scale * (re * re + im * im);
    }
  }
  std::ranges::sort(link.taps, {}, &Tap::delay_s);
  double loudest = 0.0;
  for (const Tap& tap : link.taps) loudest = std::max(loudest, std::norm(tap.gain));
  const double detectable = loudest * std::pow(10.0, -0.1 * options_.detect_range_db);
  for (const Tap& tap : link.taps) {
    if (std::norm(tap.gain) < detectable) continue;
    link.excess_delay_s = std::max(0.0, tap.delay_s - link.distance_m / kSpeedOfLightMps);
    break;
  }
  link.power_db = decibels_of(power);
  link.status = LinkStatus::kOk;
}

double IndoorRoom::wall_loss_db(const Eigen::Vector3d& a_m, const Eigen::Vector3d& b_m) const {
  if (!a_m.allFinite() || !b_m.allFinite()) return std::nan("");
  const double plan = std::hypot(b_m.x() - a_m.x(), b_m.y() - a_m.y());
  const double length = (b_m - a_m).norm();
  if (!(length > 0.0)) return 0.0;
  Complex gain = 1.0;
  double delay_s = 0.0;
  through({a_m.x(), a_m.y(), b_m.x(), b_m.y(), 0.0, 1.0, -1, -1},
          {a_m.z(), b_m.z(), options_.height_m, 0, plan / length}, gain, delay_s);
  return std::max(0.0, -decibels_of(std::norm(gain)));
}

void excess_delays(std::span<const std::uint8_t> line_of_sight, std::size_t links, double dt_s,
                   const ExcessDelayOptions& options, const RandomStream& random, std::span<double> excess_m) {
  const auto& o = options;
  require(links > 0 && line_of_sight.size() % links == 0, "links", static_cast<double>(links),
          "it must be positive and divide the flags");
  require(excess_m.size() == line_of_sight.size(), "excess_m", static_cast<double>(excess_m.size()),
          "it must have as many as line_of_sight");
  require(std::isfinite(dt_s) && dt_s > 0.0, "dt_s", dt_s, "it must be positive");
  require(o.floor_m >= 0.0 && std::isfinite(o.floor_m), "floor_m", o.floor_m, "it must be 0 or more");
  require(o.low_m >= o.floor_m, "low_m", o.low_m, "it must be at least floor_m");
  require(o.high_m >= o.low_m && std::isfinite(o.high_m), "high_m", o.high_m, "it must be at least low_m");
  require(std::isfinite(o.wander_m_per_sqrt_s) && o.wander_m_per_sqrt_s >= 0.0, "wander_m_per_sqrt_s",
          o.wander_m_per_sqrt_s, "it must be 0 or more");
  const double step = o.wander_m_per_sqrt_s * std::sqrt(dt_s);
  const std::size_t epochs = line_of_sight.size() / links;
  for (std::size_t l = 0; l < links; ++l) {
    RandomStream stream = random.substream(l);
    double excess = 0.0;
    bool shut = false;
    for (std::size_t k = 0; k < epochs; ++k) {
      const double fresh = stream.uniform(o.low_m, o.high_m);
      const double wander = step * stream.normal();
      const bool now = line_of_sight[k * links + l] == 0;
      if (!now) {
        excess = 0.0;
      } else if (!shut) {
        excess = fresh;
      } else {
        excess = o.floor_m + std::abs(excess + wander - o.floor_m);
      }
      shut = now;
      excess_m[k * links + l] = excess;
    }
  }
}

}  // namespace soopnav::simulation
