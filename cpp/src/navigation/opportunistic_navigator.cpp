#include "soopnav/navigation/opportunistic_navigator.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>
#include <utility>

#include "navigation/opportunistic_state.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/covariance_check.hpp"

namespace soopnav::navigation {

namespace {

using detail::Member;
using detail::Slot;

constexpr int kReceiverMax = 8;

[[noreturn]] void refuse_option(const char* name, double value, const char* rule) {
  throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + " must be " + rule);
}

void require_option(bool good, const char* name, double value, const char* rule) {
  if (!good) refuse_option(name, value, rule);
}

void require_density(double value, const char* name) {
  require_option(value >= 0.0 && std::isfinite(value), name, value, "finite and >= 0");
}

void require_noise(const clock::ClockNoise& noise, const char* name) {
  require_density(noise.white_frequency_m2ps, (std::string(name) + ".white_frequency_m2ps").c_str());
  require_density(noise.frequency_walk_m2ps3, (std::string(name) + ".frequency_walk_m2ps3").c_str());
}

const OpportunisticOptions& checked(const OpportunisticOptions& o) {
  require_option(o.max_sources >= 1 && o.max_sources <= 1000, "max_sources", o.max_sources, "in 1 ... 1000");
  require_option(o.max_observables >= 0 && o.max_observables <= 10000, "max_observables", o.max_observables,
                 "in 0 ... 10000");
  require_noise(o.clock, "clock");
  require_density(o.position_walk_m2ps, "position_walk_m2ps");
  require_density(o.acceleration_psd_m2ps3, "acceleration_psd_m2ps3");
  require_option(o.fault_probability > 0.0 && o.fault_probability <= 0.1, "fault_probability", o.fault_probability,
                 "in (0, 0.1]");
  require_option(o.suspend_share > 0.0 && o.suspend_share <= 1.0, "suspend_share", o.suspend_share, "in (0, 1]");
  require_option(o.suspend_memory >= 1.0 && std::isfinite(o.suspend_memory), "suspend_memory", o.suspend_memory,
                 "finite and >= 1");
  return o;
}

int rows_of(const OpportunisticOptions& o) { return o.max_observables > 0 ? o.max_observables : 2 * o.max_sources; }

int receiver_dim(OpportunisticMotion motion) {
  if (motion == OpportunisticMotion::kVelocity) return 8;
  return motion == OpportunisticMotion::kStatic ? 5 : 2;
}

// Bias and drift, as the interface has them, in the order of the state: the rate first.
Eigen::Matrix2d rate_first(const Eigen::Matrix2d& P) {
  Eigen::Matrix2d out;
  out << P(1, 1), P(0, 1), P(0, 1), P(0, 0);
  return out;
}

constexpr const char* kAxis[] = {"x", "y", "z"};

std::string part_name(int part) {
  if (part < 3) return std::string("velocity ") + kAxis[part];
  if (part < 6) return std::string("position ") + kAxis[part - 3];
  return part == 6 ? "clock drift" : part == 7 ? "clock bias" : "ambiguity";
}

}  // namespace

std::string_view to_string(ObservableUse use) noexcept {
  constexpr std::string_view kText[] = {"missing",    "accepted",  "slip",
                                        "gated",      "suspended", "unknown source",
                                        "not finite", "undefined", "not positive definite",
                                        "too many"};
  const auto i = static_cast<std::size_t>(use);
  return i < std::size(kText) ? kText[i] : "unknown";
}

OpportunisticNavigator::Impl::Impl(const OpportunisticStart& start, const OpportunisticOptions& given)
    : options(checked(given)),
      known_position(start.position_e_m),
      filter(options.form, kReceiverMax + 6 * options.max_sources, rows_of(options)),
      layout(receiver_dim(options.motion), kReceiverMax + 6 * options.max_sources, 3 * options.max_sources),
      slots(static_cast<std::size_t>(options.max_sources)),
      S(1),
      inverse(1),
      whitened(1),
      start_x(2 * static_cast<std::size_t>(filter.stride())) {
  soopnav::detail::check_state(start.position_e_m, "position_e_m");
  require_option(std::isfinite(start.clock_bias_m), "clock_bias_m", start.clock_bias_m, "finite");
  require_option(std::isfinite(start.clock_drift_mps), "clock_drift_mps", start.clock_drift_mps, "finite");
  check_covariance(start.clock_covariance, "clock_covariance", true);
  const auto m = static_cast<std::size_t>(rows_of(options));
  members.reserve(static_cast<std::size_t>(kReceiverMax + 6 * options.max_sources));
  const auto join = [this](int part) {
    members.push_back({next_uid++, -1, part});
    names.push_back(part_name(part));
    owners.push_back(-1);
  };
  if (options.motion == OpportunisticMotion::kVelocity) {
    soopnav::detail::check_state(start.velocity_e_mps, "velocity_e_mps");
    check_covariance(start.velocity_covariance_m2ps2, "velocity_covariance_m2ps2", true);
    velocity_at = 0;
    filter.append(3, start.velocity_e_mps.data(), start.velocity_covariance_m2ps2.data());
    for (int i = 0; i < 3; ++i) join(i);
  }
  if (options.motion != OpportunisticMotion::kKnown) {
    check_covariance(start.position_covariance_m2, "position_covariance_m2", true);
    position_at = filter.dim();
    filter.append(3, start.position_e_m.data(), start.position_covariance_m2.data());
    for (int i = 3; i < 6; ++i) join(i);
  }
  drift_at = filter.dim();
  bias_at = drift_at + 1;
  const Eigen::Vector2d clock(start.clock_drift_mps, start.clock_bias_m);
  const Eigen::Matrix2d P = rate_first(start.clock_covariance);
  filter.append(2, clock.data(), P.data());
  join(6);
  join(7);
  threshold = chi_square_upper_quantile(options.fault_probability, 1);

  order.reserve(slots.size());
  rows.reserve(m);
  touched.reserve(m);
  used_touched.reserve(m);
  next_touched.reserve(m);
  next_innovation.reserve(m);
  innovation.reserve(m);
  variance.reserve(m);
  used_innovation.reserve(m);
  used_variance.reserve(m);
  tested.reserve(m);
  used.reserve(m);
  reports.resize(m);
  pairs.reserve(static_cast<std::size_t>(4 + options.max_sources));
  noises.reserve(3 + 12 * slots.size() + 4 * m);
  pending.reserve(static_cast<std::size_t>(filter.stride()));
  S_stride = static_cast<int>((m + 7) / 8 * 8);
  S = detail::AlignedDoubles(static_cast<std::size_t>(S_stride) * m);
  inverse = detail::AlignedDoubles(static_cast<std::size_t>(S_stride) * m);
  whitened = detail::AlignedDoubles(3 * static_cast<std::size_t>(S_stride));
  past.resize(static_cast<std::size_t>(detail::kObservedEpochs) * m);
}

int OpportunisticNavigator::Impl::slot_of(int id) const noexcept {
  for (const int s : order) {
    if (slots[static_cast<std::size_t>(s)].id == id) return s;
  }
  return -1;
}

OpportunisticNavigator::OpportunisticNavigator(const OpportunisticStart& start, const OpportunisticOptions& options)
    : impl_(std::make_unique<Impl>(start, options)) {}
OpportunisticNavigator::OpportunisticNavigator(OpportunisticNavigator&&) noexcept = default;
OpportunisticNavigator& OpportunisticNavigator::operator=(OpportunisticNavigator&&) noexcept = default;
OpportunisticNavigator::~OpportunisticNavigator() = default;

int OpportunisticNavigator::add_source(const OpportunisticSource& given) {
  Impl& me = *impl_;
  if (given.name.empty() || given.name.size() > detail::kMaxNameLength) {
    throw std::invalid_argument("name = '" + given.name + "': 1 to 20 characters expected");
  }
  if (find_source(given.name) >= 0) {
    throw std::invalid_argument("name = '" + given.name + "': a source of this name is present");
  }
  require_option(given.carrier_hz > 0.0 && std::isfinite(given.carrier_hz), "carrier_hz", given.carrier_hz,
                 "positive and finite");
  if (given.orbit && given.position_e_m) {
    throw std::invalid_argument("orbit, position_e_m: at most one expected");
  }
  if (given.position_e_m) soopnav::detail::check_state(*given.position_e_m, "position_e_m");
  if (given.position_covariance_m2) {
    if (!given.position_e_m) throw std::invalid_argument("position_e_m: expected with its covariance");
    check_covariance(*given.position_covariance_m2, "position_covariance_m2", true);
  }
  for (const auto& [value, name] : {std::pair{given.clock_bias_m, "clock_bias_m"},
                                    {given.clock_drift_mps, "clock_drift_mps"},
                                    {given.clock_epoch_s, "clock_epoch_s"},
                                    {given.ambiguity_cycles, "ambiguity_cycles"}}) {
    require_option(std::isfinite(value), name, value, "finite");
  }
  if (given.clock_estimated) {
    require_noise(given.clock_noise, "clock_noise");
    check_covariance(given.clock_covariance, "clock_covariance", true);
  }
  if (given.ambiguity_estimated) {
    require_option(given.ambiguity_sigma_cycles > 0.0 && std::isfinite(given.ambiguity_sigma_cycles),
                   "ambiguity_sigma_cycles", given.ambiguity_sigma_cycles, "positive and finite");
  }
  require_density(given.ambiguity_walk_cycles2ps, "ambiguity_walk_cycles2ps");
  require_density(given.position_walk_m2ps, "position_walk_m2ps");
  const auto free = std::find_if(me.slots.begin(), me.slots.end(), [](const Slot& s) { return !s.present; });
  if (free == me.slots.end()) {
    throw std::invalid_argument("max_sources = " + std::to_string(me.options.max_sources) + ": no room for '" +
                                given.name + "'");
  }
  me.names.reserve(me.names.size() + 6);
  me.owners.reserve(me.owners.size() + 6);

  Slot& slot = *free;
  slot = Slot();
  slot.given = given;
  slot.given.name.clear();
  std::copy(given.name.begin(), given.name.end(), slot.name.begin());
  slot.id = me.next_id++;
  slot.wavelength_m = kSpeedOfLightMps / given.carrier_hz;
  const auto join = [&](int first_part, int count, const double* mean, const double* P) {
    me.filter.append(count, mean, P);
    for (int i = 0; i < count; ++i) {
      me.members.push_back({me.next_uid++, slot.id, first_part + i});
      me.names.push_back(given.name + " " + part_name(first_part + i));
      me.owners.push_back(slot.id);
    }
  };
  if (given.position_e_m && !given.position_covariance_m2) {
    slot.rest = geometry::SampledOrbit::fixed(*given.position_e_m);
    slot.has_rest = true;
  } else if (given.position_e_m) {
    slot.position = me.layout.add<3>(given.name);
    join(3, 3, given.position_e_m->data(), given.position_covariance_m2->data());
  }
  if (given.clock_estimated) {
    slot.clock = me.layout.add<2>(given.name);
    const Eigen::Vector2d mean(given.clock_drift_mps, given.clock_bias_m);
    const Eigen::Matrix2d P = rate_first(given.clock_covariance);
    join(6, 2, mean.data(), P.data());
  }
  if (given.ambiguity_estimated) {
    slot.ambiguity = me.layout.add<1>(given.name);
    const double square = given.ambiguity_sigma_cycles * given.ambiguity_sigma_cycles;
    join(8, 1, &given.ambiguity_cycles, &square);
  }
  slot.present = true;
  me.order.push_back(static_cast<int>(free - me.slots.begin()));
  return slot.id;
}

bool OpportunisticNavigator::remove_source(int source) noexcept {
  Impl& me = *impl_;
  const int s = me.slot_of(source);
  if (s < 0) return false;
  Slot& slot = me.slots[static_cast<std::size_t>(s)];
  if (me.recorder.active() &&
      (me.layout.holds(slot.position) || me.layout.holds(slot.clock) || me.layout.holds(slot.ambiguity))) {
    me.recorder.leaving(me.t_s, me.members, me.filter);
  }
  const auto leave = [&](const auto& block) {
    if (!me.layout.holds(block)) return;
    const int first = me.layout.offset(block);
    constexpr int kDim = std::remove_cvref_t<decltype(block)>::kDim;
    me.filter.erase(first, kDim);
    me.members.erase(me.members.begin() + first, me.members.begin() + first + kDim);
    me.layout.remove(block);
  };
  leave(slot.position);
  leave(slot.clock);
  leave(slot.ambiguity);
  slot.present = false;
  slot.given.orbit.reset();
  me.order.erase(std::find(me.order.begin(), me.order.end(), s));
  return true;
}

std::vector<int> OpportunisticNavigator::sources() const {
  std::vector<int> out;
  for (const int s : impl_->order) out.push_back(impl_->slots[static_cast<std::size_t>(s)].id);
  return out;
}

int OpportunisticNavigator::find_source(std::string_view name) const noexcept {
  for (const int s : impl_->order) {
    const Slot& slot = impl_->slots[static_cast<std::size_t>(s)];
    if (name == slot.name.data()) return slot.id;
  }
  return -1;
}

std::optional<OpportunisticSourceState> OpportunisticNavigator::source(int source) const noexcept {
  const Impl& me = *impl_;
  const int s = me.slot_of(source);
  if (s < 0) return std::nullopt;
  const Slot& slot = me.slots[static_cast<std::size_t>(s)];
  OpportunisticSourceState out;
  out.suspended = slot.suspended;
  out.slip_rate = slot.slip_rate;
  out.slips = slot.slips;
  out.jumps = slot.jumps;
  out.clock_drift_mps = slot.given.clock_drift_mps;
  out.clock_bias_m = slot.given.clock_bias_m;
  if (std::isfinite(me.t_s)) out.clock_bias_m += slot.given.clock_drift_mps * (me.t_s - slot.given.clock_epoch_s);
  if (me.layout.holds(slot.clock)) {
    const int at = me.layout.offset(slot.clock);
    out.clock_drift_mps = me.filter.x()[at];
    out.clock_bias_m = me.filter.x()[at + 1];
    out.clock_covariance << me.filter.covariance(at + 1, at + 1), me.filter.covariance(at + 1, at),
        me.filter.covariance(at + 1, at), me.filter.covariance(at, at);
  }
  out.ambiguity_cycles = slot.given.ambiguity_cycles;
  if (me.layout.holds(slot.ambiguity)) {
    const int at = me.layout.offset(slot.ambiguity);
    out.ambiguity_cycles = me.filter.x()[at];
    out.ambiguity_sigma_cycles = std::sqrt(me.filter.covariance(at, at));
  }
  if (slot.given.position_e_m) out.position_e_m = *slot.given.position_e_m;
  if (me.layout.holds(slot.position)) {
    const int at = me.layout.offset(slot.position);
    for (int i = 0; i < 3; ++i) {
      out.position_e_m[i] = me.filter.x()[at + i];
      for (int j = 0; j < 3; ++j) out.position_covariance_m2(i, j) = me.filter.covariance(at + i, at + j);
    }
  }
  return out;
}

OpportunisticReport OpportunisticNavigator::step(double t_s,
                                                 std::span<const OpportunisticObservation> observed) noexcept {
  return impl_->step(t_s, observed);
}

std::span<const ObservableReport> OpportunisticNavigator::reports() const noexcept {
  return {impl_->reports.data(), impl_->reported};
}

bool OpportunisticNavigator::expected(double t_s, const OpportunisticObservation& observed, double& value,
                                      std::span<double> jacobian) const noexcept {
  const Impl& me = *impl_;
  const int s = me.slot_of(observed.source);
  if (s < 0 || jacobian.size() != static_cast<std::size_t>(dim())) return false;
  detail::TouchedRow row;
  double predicted = 0.0;
  if (!me.model(observed, me.slots[static_cast<std::size_t>(s)], t_s, row, predicted)) return false;
  value = predicted;
  for (int i = 0; i < dim(); ++i) jacobian[static_cast<std::size_t>(i)] = row.at(i);
  return true;
}

bool OpportunisticNavigator::open_ambiguity(int source, double sigma_cycles) noexcept {
  Impl& me = *impl_;
  const int s = me.slot_of(source);
  if (s < 0 || !(sigma_cycles >= 0.0) || std::isinf(sigma_cycles)) return false;
  Slot& slot = me.slots[static_cast<std::size_t>(s)];
  if (!me.layout.holds(slot.ambiguity)) return false;
  me.ask(me.layout.offset(slot.ambiguity), sigma_cycles * sigma_cycles);
  slot.fresh = true;
  ++slot.serial;
  return true;
}

bool OpportunisticNavigator::readmit(int source) noexcept {
  const int s = impl_->slot_of(source);
  if (s < 0 || !impl_->slots[static_cast<std::size_t>(s)].suspended) return false;
  impl_->slots[static_cast<std::size_t>(s)].suspended = false;
  impl_->slots[static_cast<std::size_t>(s)].slip_rate = 0.0;
  return true;
}

bool OpportunisticNavigator::open_clock(int source, double bias_sigma_m, double drift_sigma_mps) noexcept {
  Impl& me = *impl_;
  for (const double sigma : {bias_sigma_m, drift_sigma_mps}) {
    if (!(sigma >= 0.0) || std::isinf(sigma)) return false;
  }
  int drift_at = me.drift_at;
  if (source != -1) {
    const int s = me.slot_of(source);
    if (s < 0) return false;
    Slot& slot = me.slots[static_cast<std::size_t>(s)];
    if (!me.layout.holds(slot.clock)) return false;
    drift_at = me.layout.offset(slot.clock);
    ++slot.serial;
  } else {
    me.past_epochs = 0;
  }
  me.ask(drift_at, drift_sigma_mps * drift_sigma_mps);
  me.ask(drift_at + 1, bias_sigma_m * bias_sigma_m);
  return true;
}

bool OpportunisticNavigator::set_clock_noise(int source, const clock::ClockNoise& noise) noexcept {
  Impl& me = *impl_;
  for (const double density : {noise.white_frequency_m2ps, noise.frequency_walk_m2ps3}) {
    if (!(density >= 0.0) || std::isinf(density)) return false;
  }
  if (source == -1) {
    me.options.clock = noise;
    return true;
  }
  const int s = me.slot_of(source);
  if (s < 0 || !me.layout.holds(me.slots[static_cast<std::size_t>(s)].clock)) return false;
  me.slots[static_cast<std::size_t>(s)].given.clock_noise = noise;
  return true;
}

bool OpportunisticNavigator::started() const noexcept { return std::isfinite(impl_->t_s); }
double OpportunisticNavigator::t_s() const noexcept { return impl_->t_s; }
int OpportunisticNavigator::dim() const noexcept { return impl_->filter.dim(); }

std::vector<std::string> OpportunisticNavigator::component_names() const {
  std::vector<std::string> out;
  for (const Member& m : impl_->members) out.push_back(impl_->names[static_cast<std::size_t>(m.uid)]);
  return out;
}

Eigen::VectorXd OpportunisticNavigator::mean() const {
  return Eigen::Map<const Eigen::VectorXd>(impl_->filter.x(), impl_->filter.dim());
}

Eigen::MatrixXd OpportunisticNavigator::covariance() const {
  Eigen::MatrixXd P(dim(), dim());
  impl_->filter.covariance(P.data());
  return P;
}

Eigen::Vector3d OpportunisticNavigator::position_e_m() const noexcept {
  if (impl_->position_at < 0) return impl_->known_position;
  return Eigen::Map<const Eigen::Vector3d>(impl_->filter.x() + impl_->position_at);
}

Eigen::Matrix3d OpportunisticNavigator::position_covariance_m2() const noexcept {
  Eigen::Matrix3d P = Eigen::Matrix3d::Zero();
  const int at = impl_->position_at;
  for (int i = 0; i < 3 && at >= 0; ++i) {
    for (int j = 0; j < 3; ++j) P(i, j) = impl_->filter.covariance(at + i, at + j);
  }
  return P;
}

Eigen::Vector3d OpportunisticNavigator::velocity_e_mps() const noexcept {
  if (impl_->velocity_at < 0) return Eigen::Vector3d::Zero();
  return Eigen::Map<const Eigen::Vector3d>(impl_->filter.x() + impl_->velocity_at);
}

double OpportunisticNavigator::clock_bias_m() const noexcept { return impl_->filter.x()[impl_->bias_at]; }
double OpportunisticNavigator::clock_drift_mps() const noexcept { return impl_->filter.x()[impl_->drift_at]; }

Eigen::Matrix2d OpportunisticNavigator::clock_covariance() const noexcept {
  const auto& f = impl_->filter;
  const int b = impl_->bias_at;
  const int d = impl_->drift_at;
  Eigen::Matrix2d P;
  P << f.covariance(b, b), f.covariance(b, d), f.covariance(b, d), f.covariance(d, d);
  return P;
}

void OpportunisticNavigator::start_recording(int epochs) {
  if (epochs < 1 || epochs > 100000000) refuse_option("epochs", epochs, "in 1 ... 1e8");
  const auto& o = impl_->options;
  impl_->recorder.reserve(epochs, impl_->filter.stride(), 4 + o.max_sources,
                          static_cast<int>(impl_->noises.capacity()));
}

int OpportunisticNavigator::recorded() const noexcept { return impl_->recorder.steps(); }

}  // namespace soopnav::navigation
