#include "soopnav/navigation/source_locator.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <vector>

#include "navigation/source_bank.hpp"
#include "navigation/source_batch.hpp"
#include "navigation/source_filter.hpp"
#include "navigation/source_particles.hpp"
#include "navigation/source_sight.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"

namespace soopnav::navigation {

using namespace detail;  // NOLINT(google-build-using-namespace): the parts of this very class

namespace {

constexpr double kOnTheWay = 0.1;      // of the step aside: nearer than that to the line it is on the way
constexpr double kMostOutliers = 0.2;  // share of the bearings that a position may leave unexplained

bool keeps_bearings(SourceMethod m) noexcept {
  return m != SourceMethod::kExtendedKalman && m != SourceMethod::kEkfBank && m != SourceMethod::kParticle;
}
bool geometric(SourceMethod m) noexcept { return m == SourceMethod::kCentroid || m == SourceMethod::kIncenter; }

}  // namespace

struct SourceLocator::Impl {
  // The last innovations of the one filter, squared and normalised: whether it still believes what it hears.
  struct Recent {
    static constexpr std::size_t kLength = 12;
    std::array<double, kLength> nis{};
    std::size_t count = 0;

    void add(double value) noexcept { nis[count++ % kLength] = value; }
    [[nodiscard]] std::size_t size() const noexcept { return std::min(count, kLength); }
    [[nodiscard]] double sum() const noexcept {
      return std::accumulate(nis.begin(), nis.begin() + static_cast<std::ptrdiff_t>(size()), 0.0);
    }
  };

  SourceOptions options;
  Layout layout;
  std::vector<Kept> kept;
  std::size_t used = 0;
  std::size_t rejected = 0;
  BearingUse last = BearingUse::kUsed;
  bool diverged = false;
  Kept newest;  // of those used
  std::array<double, 3> first_place{};
  double reach_m = 0.0;  // largest distance of the platform from where it began
  Heading heading;
  Sight sight;
  Flips flips;
  TripleSum triples;
  std::size_t seen = 0;  // bearings since the start, for the triangles' spacing
  bool started = false;
  Gaussian state;
  Recent recent;
  EkfBank bank;
  std::unique_ptr<Particles> cloud;
  std::unique_ptr<SearchGrid> grid;
  double grid_radius_m = 0.0;
  Solution previous;

  explicit Impl(const SourceOptions& o)
      : options(o),
        layout{static_cast<std::size_t>(o.dimensions), o.motion == SourceMotion::kConstantVelocity,
               o.heading_bias_sigma_rad > 0.0},
        bank(o, layout) {
    if (keeps_bearings(o.method)) kept.reserve(o.max_bearings);
    if (o.method == SourceMethod::kParticle) {
      cloud = std::make_unique<Particles>(o.particles, layout.dimensions);
      cloud->clear(o.seed);
    }
    if (o.method == SourceMethod::kMaximumLikelihood || o.method == SourceMethod::kLeastSquares) {
      grid = std::make_unique<SearchGrid>(o.grid_size);
    }
  }

  void reset() noexcept {
    kept.clear();
    used = rejected = seen = 0;
    last = BearingUse::kUsed;
    diverged = started = false;
    reach_m = grid_radius_m = 0.0;
    heading = {};
    sight = {};
    flips = {};
    triples = {};
    recent = {};
    bank.clear();
    previous = {};
    if (cloud) cloud->clear(options.seed);
    if (grid) grid->clear();
  }

  BearingUse take(const SourceBearing& bearing) noexcept {
    Kept k;
    BearingUse why = pack(bearing, layout.dimensions, k);
    if (why != BearingUse::kUsed) return why;
    const bool ordered = layout.moving || !keeps_bearings(options.method);
    if (ordered && used > 0 && k.t_s < newest.t_s) return BearingUse::kOutOfOrder;
    switch (options.method) {
      case SourceMethod::kExtendedKalman:
        why = step_filter(k);
        break;
      case SourceMethod::kEkfBank:
        why = bank.step(k);
        break;
      case SourceMethod::kParticle:
        step_particles(k);
        break;
      default:
        keep(k);
        break;
    }
    if (why != BearingUse::kUsed) return why;
    if (used == 0) first_place = {k.b.x, k.b.y, k.b.z};
    reach_m = std::max(reach_m, std::hypot(k.b.x - first_place[0], k.b.y - first_place[1], k.b.z - first_place[2]));
    heading.add(k);
    sight.add(k, layout.dimensions == 3);
    flips.add(k);
    newest = k;
    ++used;
    return why;
  }

  void keep(const Kept& k) noexcept {
    if (kept.size() == options.max_bearings) {  // a quarter at a time, so that dropping costs little
      const auto from = kept.begin() + static_cast<std::ptrdiff_t>((options.max_bearings + 3) / 4);
      std::copy(from, kept.end(), kept.begin());
      kept.resize(kept.size() - static_cast<std::size_t>(from - kept.begin()));
      if (grid) grid->clear();
      sight = {};
      for (const Kept& old : kept) sight.add(old, layout.dimensions == 3);
    }
    kept.push_back(k);
    ++seen;
    if (!geometric(options.method)) return;
    const auto s = static_cast<std::size_t>(options.triple_spacing);
    const std::size_t n = kept.size();
    if (n > 2 * s) {
      add_triple(kept[n - 1 - 2 * s], kept[n - 1 - s], kept[n - 1], options.method == SourceMethod::kIncenter,
                 layout.dimensions == 3, options.min_crossing_rad, triples);
    }
  }

  // The start that was asked for; there must be one.
  [[nodiscard]] Vector start_place() const noexcept {
    Vector at{};
    for (std::size_t i = 0; i < layout.dimensions; ++i) at[i] = (*options.start_m)[static_cast<Eigen::Index>(i)];
    return at;
  }

  BearingUse step_filter(const Kept& k) noexcept {
    if (!started) {
      if (options.start_m) {
        state = {};
        state.x = start_place();
        for (std::size_t i = 0; i < layout.dimensions; ++i) {
          state.P[i][i] = options.start_sigma_m * options.start_sigma_m;
        }
        finish_start(options, layout, state);
      } else {
        const double range = std::sqrt(options.min_range_m * options.max_range_m);
        start_along(options, layout, k, k.azimuth, std::sqrt(k.b.variance_azimuth), range, range, state);
        started = true;
        return BearingUse::kUsed;
      }
      started = true;
    } else {
      propagate(layout, k.t_s - newest.t_s, options.acceleration_psd, state);
    }
    double density = 0.0;
    double nis = 0.0;
    if (!update(layout, k.t_s, k, state, density, &nis)) {
      // The state stands at the new bearing's time all the same.
      newest.t_s = k.t_s;
      return BearingUse::kUndefined;
    }
    recent.add(nis);
    return BearingUse::kUsed;
  }

  void step_particles(const Kept& k) noexcept {
    if (diverged) return;
    if (!cloud->started()) {
      if (options.start_m) {
        cloud->start(start_place(), options.start_sigma_m);
      } else {
        cloud->start(k, options.min_range_m, options.max_range_m, options.outlier_probability);
        return;
      }
    }
    diverged = !cloud->weigh(k.b, options.outlier_probability, options.ess_threshold);
  }

  // --- solving -------------------------------------------------------------------------------------------------------

  [[nodiscard]] bool unmoved() const noexcept {
    return reach_m <= 1e-9 * (1.0 + std::abs(first_place[0]) + std::abs(first_place[1]));
  }

  // The bearings point to one far place: no range.
  [[nodiscard]] bool parallel() const noexcept { return unmoved() || sight.parallel(layout.dimensions == 3); }

  [[nodiscard]] Problem problem(double outlier) const noexcept {
    return {layout, kept, newest.t_s, outlier, options.heading_bias_sigma_rad, options.max_iterations};
  }

  // A state of the layout at a place in the plane: height from the elevations there, at rest, no bias.
  [[nodiscard]] Vector lifted(double x, double y) const noexcept {
    Vector out{};
    out[0] = x;
    out[1] = y;
    if (layout.dimensions == 3) {
      double sum = 0.0;
      double weight = 0.0;
      for (const Kept& k : kept) {
        const double level = std::hypot(x - k.b.x, y - k.b.y) + 1e-3;
        const double c = std::cos(k.b.elevation);
        const double w = c * c * c * c / (level * level * k.b.variance_elevation);
        if (!(c > 1e-3)) continue;
        sum += w * (k.b.z + level * std::tan(k.b.elevation));
        weight += w;
      }
      out[2] = weight > 0.0 ? sum / weight : 0.0;
    }
    return out;
  }

  void consider(const Problem& p, const Vector& start, Solution& best) const noexcept {
    const Solution s = search(p, start);
    if (s.solved && (!best.solved || s.cost < best.cost)) best = s;
  }

  Solution solve_likelihood() noexcept {
    const double outlier = options.method == SourceMethod::kMaximumLikelihood ? options.outlier_probability : 0.0;
    std::array<Vector, 5 + 2 * Flips::kMost> starts{};
    std::size_t count = 0;
    if (options.start_m && options.method == SourceMethod::kLeastSquares) starts[count++] = start_place();
    const Solution linear = pseudo_linear(layout.dimensions, kept, true, options.max_iterations);
    if (linear.solved) starts[count++] = linear.x;
    std::array<double, 2> centre = {first_place[0], first_place[1]};
    double need = options.max_range_m + reach_m;
    if (options.start_m) {
      centre = {(*options.start_m)[0], (*options.start_m)[1]};
      need = 3.0 * options.start_sigma_m;
    }
    if (need > grid_radius_m) grid_radius_m = options.start_m ? need : 1.3 * need;
    std::array<std::array<double, 2>, 3> peaks{};
    grid->fill(kept, centre[0], centre[1], grid_radius_m, options.outlier_probability);
    const std::size_t found = grid->peaks(kept, options.outlier_probability, peaks);
    for (std::size_t i = 0; i < found; ++i) starts[count++] = lifted(peaks[i][0], peaks[i][1]);
    // Where the platform drove over the source no crossing and no cell of the grid is near enough.
    for (std::size_t i = 0; i < (layout.moving ? 0 : flips.size()); ++i) {
      const Flips::Place& f = flips.places[i];
      for (const double side : {-1.0, 1.0}) {
        starts[count++] = lifted(f.at[0] + side * f.across[0], f.at[1] + side * f.across[1]);
      }
    }
    Solution best;
    const Problem goal = problem(outlier);
    for (std::size_t i = 0; i < count; ++i) consider(goal, starts[i], best);
    if (previous.solved) consider(goal, previous.x, best);
    if (layout.moving) {  // a bank over all bearings: the grid knows sources at rest only
      bank.clear();
      for (const Kept& k : kept) static_cast<void>(bank.step(k));
      Gaussian merged;
      if (bank.moments(merged)) {
        const Solution gaussian = search(problem(0.0), merged.x);
        if (gaussian.solved) consider(goal, gaussian.x, best);
        consider(goal, merged.x, best);
      }
    }
    previous = best;
    return best;
  }

  // The line of sight when nothing better is known.
  void draw_line(SourceFix& fix) const noexcept {
    SourceLine line;
    if (fix.position_m.allFinite()) {
      line.point_m = {newest.b.x, newest.b.y, newest.b.z};
      const Eigen::Vector3d to = fix.position_m - line.point_m;
      const double range = to.norm();
      if (range > 0.0 && std::isfinite(range)) {
        line.direction = to / range;
        const double level = std::hypot(to[0], to[1]);
        const Eigen::Vector2d across(-to[1] / level, to[0] / level);
        line.sigma_rad = std::sqrt(across.dot(fix.covariance_m2.topLeftCorner<2, 2>() * across)) / level;
        if (level > 0.0) fix.line = line;
        return;
      }
    }
    if (!(heading.weight > 0.0)) return;
    for (Eigen::Index i = 0; i < 3; ++i) line.point_m[i] = heading.place[static_cast<std::size_t>(i)] / heading.weight;
    const double azimuth = std::atan2(heading.s, heading.c);
    const double elevation = layout.dimensions == 3 ? heading.elevation / heading.elevation_weight : 0.0;
    line.direction = {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                      std::sin(elevation)};
    line.sigma_rad = 1.0 / std::sqrt(heading.weight);
    fix.line = line;
  }

  // Where the direction turned round on the way the source is between two places of the platform, and a linearised
  // covariance means little. True when that settles the status.
  bool judge_flips(SourceFix& fix) const noexcept {
    if (layout.moving || flips.found == 0 || !fix.position_m.allFinite()) return false;
    bool there = false;
    for (std::size_t i = 0; i < flips.size(); ++i) {
      const Flips::Place& f = flips.places[i];
      const double dx = fix.position_m[0] - f.at[0];
      const double dy = fix.position_m[1] - f.at[1];
      if (std::hypot(dx, dy) > kFlipPlaces * f.apart_m) continue;
      there = true;
      if (std::abs(dx * f.across[0] + dy * f.across[1]) < kOnTheWay * kStepAside * f.apart_m * f.apart_m) {
        fix.status = SourceStatus::kOnPlatform;
        return true;
      }
    }
    // The likelihood and least squares began there as well, and found something better.
    const bool searched =
        options.method == SourceMethod::kMaximumLikelihood || options.method == SourceMethod::kLeastSquares;
    if (there || searched) return false;
    fix.status = SourceStatus::kInconsistent;
    return true;
  }

  // A mean of crossings, or the unweighted lines, that explain the bearings worse than one direction does: their bias.
  void judge_biased(SourceFix& fix) const noexcept {
    const Vector x{fix.position_m[0], fix.position_m[1], fix.position_m[2]};
    const Layout rest{layout.dimensions, false, false};
    double chi = 0.0;
    Angles angles;
    for (const Kept& k : kept) {
      if (!predict(rest, x, 0.0, k, angles)) continue;
      for (std::size_t r = 0; r + 1 < layout.dimensions; ++r) {
        chi += angles.residual[r] * angles.residual[r] / angles.variance[r];
      }
    }
    judge_biased(fix, chi);
  }
  void judge_biased(SourceFix& fix, double chi) const noexcept {
    if (chi < sight.chi_square(layout.dimensions == 3)) return judge(fix);
    fix.status = SourceStatus::kUnobservable;
    draw_line(fix);
  }

  // A bank and particles that began along a bearing believe in a range up to `max_range_m`: a far source piles up
  // there.
  [[nodiscard]] bool leans_on_prior(const SourceFix& fix) const noexcept {
    const bool cloudy = options.method == SourceMethod::kParticle;
    if ((!cloudy && options.method != SourceMethod::kEkfBank) || (cloudy && options.start_m)) return false;
    const Eigen::Vector3d from = fix.position_m - Eigen::Vector3d(first_place[0], first_place[1], first_place[2]);
    const double range = from.norm();
    if (!(range > 0.0)) return false;
    const Eigen::Vector3d u = from / range;
    const double sigma = std::sqrt(std::max(u.dot(fix.covariance_m2 * u), 0.0));
    // Members of a bank are free to leave the range they began at: a small sigma is the bearings' word.
    return range + 2.0 * sigma >= options.max_range_m && (cloudy || sigma > 0.1 * range);
  }

  // Of the filters: what they cannot know of themselves, then `judge`.
  void judge_filter(SourceFix& fix) const noexcept {
    if (judge_flips(fix)) return;
    if (!fix.position_m.allFinite() || !(parallel() || leans_on_prior(fix))) return judge(fix);
    fix.status = SourceStatus::kUnobservable;
    draw_line(fix);
  }

  // Range known to half of it, and the platform's places two sigma away.
  void judge(SourceFix& fix) const noexcept {
    if (!fix.position_m.allFinite() || !fix.covariance_m2.allFinite()) return;
    const Eigen::Matrix2d P = fix.covariance_m2.topLeftCorner<2, 2>();
    const double half = 0.5 * (P(0, 0) - P(1, 1));
    const double largest = std::max(0.5 * (P(0, 0) + P(1, 1)) + std::hypot(half, P(0, 1)), fix.covariance_m2(2, 2));
    const Eigen::Vector3d from_first = fix.position_m - Eigen::Vector3d(first_place[0], first_place[1], first_place[2]);
    const Eigen::Vector3d from_last = fix.position_m - Eigen::Vector3d(newest.b.x, newest.b.y, newest.b.z);
    const double far = std::max(from_first.norm(), from_last.norm());
    // From one place a filter's small range error is its linearisation's word alone.
    if ((std::sqrt(largest) > 0.5 * far && far > 0.0) || unmoved()) {
      fix.status = SourceStatus::kUnobservable;
      draw_line(fix);
      return;
    }
    Matrix C{};
    Matrix L{};
    for (std::size_t i = 0; i < layout.dimensions; ++i) {
      for (std::size_t j = 0; j < layout.dimensions; ++j) {
        C[i][j] = fix.covariance_m2(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
      }
    }
    if (layout.moving || !factor(layout.dimensions, C, L)) return;
    const auto near = [&](const Kept& k) {
      const Vector miss{fix.position_m[0] - k.b.x, fix.position_m[1] - k.b.y, fix.position_m[2] - k.b.z};
      Vector scaled{};
      solve(layout.dimensions, L, miss, scaled);
      double square = 0.0;
      for (std::size_t i = 0; i < layout.dimensions; ++i) square += miss[i] * scaled[i];
      return square < 4.0;
    };
    bool on = near(newest);
    for (const Kept& k : kept) on = on || near(k);
    if (on) fix.status = SourceStatus::kOnPlatform;
  }

  void solve_kept(SourceFix& fix) noexcept {
    const std::size_t unknowns = layout.size() - (layout.biased ? 1 : 0);
    const std::size_t least = (unknowns + layout.dimensions - 2) / (layout.dimensions - 1);
    if (kept.size() < std::max<std::size_t>(least, 2)) {
      draw_line(fix);
      return;
    }
    if (parallel()) {
      fix.status = SourceStatus::kUnobservable;
      draw_line(fix);
      return;
    }
    if (geometric(options.method)) return solve_triples(fix);
    const bool pseudo = options.method == SourceMethod::kLinear || options.method == SourceMethod::kStansfield;
    const Solution s = pseudo ? pseudo_linear(layout.dimensions, kept, options.method == SourceMethod::kStansfield,
                                              options.max_iterations)
                              : solve_likelihood();
    if (!s.solved) {
      fix.status = SourceStatus::kUnobservable;
      draw_line(fix);
      return;
    }
    write_state(layout, s.x, s.covariance, fix);
    fix.chi_square = s.chi_square;
    fix.degrees_of_freedom = std::max(static_cast<int>(s.angles) - static_cast<int>(unknowns), 0);
    fix.outliers = s.outliers;
    fix.status = s.converged ? SourceStatus::kConverged : SourceStatus::kNotConverged;
    if (options.method != SourceMethod::kLinear) {
      const bool many = static_cast<double>(s.outliers) > kMostOutliers * static_cast<double>(kept.size());
      const bool large = fix.degrees_of_freedom > 0 &&
                         s.chi_square > chi_square_upper_quantile(options.false_alarm_probability,
                                                                  static_cast<double>(fix.degrees_of_freedom));
      if (many || large) fix.status = SourceStatus::kInconsistent;
    }
    const bool ended = fix.status == SourceStatus::kConverged || fix.status == SourceStatus::kNotConverged;
    if ((ended && judge_flips(fix)) || fix.status != SourceStatus::kConverged) return;
    if (options.method == SourceMethod::kLinear) {
      judge_biased(fix, s.chi_square);
    } else {
      judge(fix);
    }
  }

  void solve_triples(SourceFix& fix) noexcept {
    TripleSum all = triples;
    const auto s = static_cast<std::size_t>(options.triple_spacing);
    if (seen <= 2 * s) {  // few bearings: every triangle
      all = {};
      for (std::size_t i = 0; i < kept.size(); ++i) {
        for (std::size_t j = i + 1; j < kept.size(); ++j) {
          for (std::size_t k = j + 1; k < kept.size(); ++k) {
            add_triple(kept[i], kept[j], kept[k], options.method == SourceMethod::kIncenter, layout.dimensions == 3,
                       options.min_crossing_rad, all);
          }
        }
      }
    }
    if (all.count == 0) {
      draw_line(fix);
      return;
    }
    const auto n = static_cast<double>(all.count);
    Vector mean{};
    Matrix P{};
    for (std::size_t i = 0; i < 3; ++i) mean[i] = all.sum[i] / n;
    // Every bearing has part in three triangles: a third of them are independent.
    const double independent = n / 3.0;
    for (std::size_t i = 0; i < layout.dimensions; ++i) {
      for (std::size_t j = 0; j < layout.dimensions; ++j) {
        const double scatter = all.squares[i][j] / n - mean[i] * mean[j];
        P[i][j] = independent > 1.0 ? scatter / (independent - 1.0) : SourceFix::kNan;
      }
    }
    write_state(layout, mean, P, fix);
    fix.status = SourceStatus::kConverged;
    if (!judge_flips(fix)) judge_biased(fix);
  }

  SourceFix solve_all() noexcept {
    SourceFix fix;
    fix.dimensions = options.dimensions;
    fix.last = last;
    fix.used = used;
    fix.rejected = rejected;
    switch (options.method) {
      case SourceMethod::kExtendedKalman:
        if (!started) return fix;
        write_state(layout, state.x, state.P, fix);
        fix.chi_square = recent.sum();
        fix.degrees_of_freedom = static_cast<int>(recent.size() * (layout.dimensions - 1));
        fix.status = SourceStatus::kConverged;
        if (recent.size() > 0 && regularized_gamma_q(0.5 * static_cast<double>(fix.degrees_of_freedom),
                                                     0.5 * fix.chi_square) < options.false_alarm_probability) {
          fix.status = SourceStatus::kInconsistent;
        }
        if (fix.status == SourceStatus::kConverged) judge_filter(fix);
        return fix;
      case SourceMethod::kEkfBank: {
        Gaussian merged;
        if (!bank.started()) {
          draw_line(fix);
          return fix;
        }
        if (!bank.moments(merged)) {
          fix.status = SourceStatus::kDiverged;
          return fix;
        }
        write_state(layout, merged.x, merged.P, fix);
        fix.status = SourceStatus::kConverged;
        judge_filter(fix);
        return fix;
      }
      case SourceMethod::kParticle: {
        if (diverged) {
          fix.status = SourceStatus::kDiverged;
          return fix;
        }
        if (!cloud->started()) return fix;
        cloud->show();
        Vector mean{};
        Matrix P{};
        cloud->moments(mean, P);
        write_state(layout, mean, P, fix);
        fix.status = SourceStatus::kConverged;
        judge_filter(fix);
        return fix;
      }
      default:
        solve_kept(fix);
        return fix;
    }
  }
};

SourceLocator::SourceLocator(const SourceOptions& options) {
  options.check();
  impl_ = std::make_unique<Impl>(options);
}
SourceLocator::SourceLocator(SourceLocator&&) noexcept = default;
SourceLocator& SourceLocator::operator=(SourceLocator&&) noexcept = default;
SourceLocator::~SourceLocator() = default;

BearingUse SourceLocator::observe(const SourceBearing& bearing) noexcept {
  impl_->last = impl_->take(bearing);
  if (impl_->last != BearingUse::kUsed) ++impl_->rejected;
  return impl_->last;
}

SourceFix SourceLocator::fix() noexcept { return impl_->solve_all(); }

SourceFix SourceLocator::step(const SourceBearing& bearing) noexcept {
  static_cast<void>(observe(bearing));
  return fix();
}

void SourceLocator::reset(const std::optional<Eigen::Vector3d>& start_m, std::uint64_t seed) noexcept {
  impl_->options.start_m = start_m && start_m->allFinite() ? start_m : std::nullopt;
  impl_->options.seed = seed;
  impl_->reset();
}

const SourceOptions& SourceLocator::options() const noexcept { return impl_->options; }

std::span<const double> SourceLocator::particles(int axis) const noexcept {
  if (!impl_->cloud || axis < 0 || axis >= impl_->options.dimensions) return {};
  return impl_->cloud->coordinates(static_cast<std::size_t>(axis));
}
std::span<const double> SourceLocator::weights() const noexcept {
  return impl_->cloud ? impl_->cloud->weights() : std::span<const double>{};
}
std::size_t SourceLocator::members() const noexcept { return impl_->bank.size(); }
Eigen::Vector3d SourceLocator::member_position_m(std::size_t i) const noexcept {
  const Vector& x = impl_->bank.member(i).x;
  return {x[0], x[1], impl_->layout.dimensions == 3 ? x[2] : 0.0};
}
double SourceLocator::member_weight(std::size_t i) const noexcept { return impl_->bank.weight(i); }

}  // namespace soopnav::navigation
