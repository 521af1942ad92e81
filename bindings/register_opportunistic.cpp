#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/navigation/opportunistic_navigator.hpp"
#include "soopnav/navigation/opportunistic_smoother.hpp"

namespace soopnav::python {

namespace {

using geometry::SampledOrbit;
using navigation::ObservableKind;
using navigation::ObservableUse;
using navigation::OpportunisticBatch;
using navigation::OpportunisticForm;
using navigation::OpportunisticMotion;
using navigation::OpportunisticNavigator;
using navigation::OpportunisticObservation;
using navigation::OpportunisticOptions;
using navigation::OpportunisticSmoother;
using navigation::OpportunisticSource;
using navigation::OpportunisticStart;
using navigation::TimeTag;

template <int Size>
Eigen::Matrix<double, Size, Size> opportunistic_square(const NumbersBase& given) {
  return Eigen::Map<const Eigen::Matrix<double, Size, Size, Eigen::RowMajor>>(given.span().data());
}

Eigen::Vector3d opportunistic_vector(const NumbersBase& given) {
  return {given.span()[0], given.span()[1], given.span()[2]};
}

py::array_t<double> opportunistic_matrix(const Eigen::MatrixXd& m) {
  return to_array(std::vector<double>(m.data(), m.data() + m.size()), {m.rows(), m.cols()});  // symmetric
}

std::unique_ptr<OpportunisticNavigator> opportunistic_make(
    const Numbers<"position_e_m">& position, const Numbers<"position_sigma_m">& position_covariance,
    const Numbers<"velocity_e_mps">& velocity, const Numbers<"velocity_sigma_mps">& velocity_covariance,
    double clock_bias_m, double clock_drift_mps, const Numbers<"clock_covariance">& clock_covariance,
    std::pair<double, double> clock, int motion, int form, int time_tag, double position_walk_m2ps,
    double acceleration_psd_m2ps3, int max_sources, int max_observables, double fault_probability, double suspend_share,
    double suspend_memory) {
  OpportunisticStart start;
  start.position_e_m = opportunistic_vector(position);
  start.position_covariance_m2 = opportunistic_square<3>(position_covariance);
  start.velocity_e_mps = opportunistic_vector(velocity);
  start.velocity_covariance_m2ps2 = opportunistic_square<3>(velocity_covariance);
  start.clock_bias_m = clock_bias_m;
  start.clock_drift_mps = clock_drift_mps;
  start.clock_covariance = opportunistic_square<2>(clock_covariance);
  OpportunisticOptions o;
  o.motion = static_cast<OpportunisticMotion>(motion);
  o.form = static_cast<OpportunisticForm>(form);
  o.time_tag = static_cast<TimeTag>(time_tag);
  o.max_sources = max_sources;
  o.max_observables = max_observables;
  o.clock = {clock.first, clock.second};
  o.position_walk_m2ps = position_walk_m2ps;
  o.acceleration_psd_m2ps3 = acceleration_psd_m2ps3;
  o.fault_probability = fault_probability;
  o.suspend_share = suspend_share;
  o.suspend_memory = suspend_memory;
  return std::make_unique<OpportunisticNavigator>(start, o);
}

int opportunistic_add(OpportunisticNavigator& self, const std::string& name, double carrier_hz,
                      const std::optional<SampledOrbit>& orbit, const py::object& position,
                      const py::object& position_covariance, const std::optional<std::pair<double, double>>& clock,
                      double clock_bias_m, double clock_drift_mps, double clock_epoch_s,
                      const Numbers<"clock_covariance">& clock_covariance, bool ambiguity_estimated,
                      double ambiguity_cycles, double ambiguity_sigma_cycles, double ambiguity_walk_cycles2ps,
                      double position_walk_m2ps) {
  OpportunisticSource s;
  s.name = name;
  s.carrier_hz = carrier_hz;
  if (orbit) s.orbit = std::make_shared<const SampledOrbit>(*orbit);
  if (!position.is_none()) s.position_e_m = opportunistic_vector(Numbers<"position_e_m">(position));
  if (!position_covariance.is_none()) {
    s.position_covariance_m2 = opportunistic_square<3>(Numbers<"position_sigma_m">(position_covariance));
  }
  s.clock_estimated = clock.has_value();
  if (clock) s.clock_noise = {clock->first, clock->second};
  s.clock_bias_m = clock_bias_m;
  s.clock_drift_mps = clock_drift_mps;
  s.clock_epoch_s = clock_epoch_s;
  s.clock_covariance = opportunistic_square<2>(clock_covariance);
  s.ambiguity_estimated = ambiguity_estimated;
  s.ambiguity_cycles = ambiguity_cycles;
  s.ambiguity_sigma_cycles = ambiguity_sigma_cycles;
  s.ambiguity_walk_cycles2ps = ambiguity_walk_cycles2ps;
  s.position_walk_m2ps = position_walk_m2ps;
  return self.add_source(s);
}

py::object opportunistic_source(const OpportunisticNavigator& self, int id) {
  const auto found = self.source(id);
  if (!found) return py::none();
  py::dict out;
  out["suspended"] = found->suspended;
  out["slip_rate"] = found->slip_rate;
  out["slips"] = found->slips;
  out["jumps"] = found->jumps;
  out["clock_bias_m"] = found->clock_bias_m;
  out["clock_drift_mps"] = found->clock_drift_mps;
  out["clock_covariance"] = opportunistic_matrix(found->clock_covariance);
  out["ambiguity_cycles"] = found->ambiguity_cycles;
  out["ambiguity_sigma_cycles"] = found->ambiguity_sigma_cycles;
  const Eigen::Vector3d& p = found->position_e_m;
  out["position_e_m"] = to_array(std::vector<double>{p.x(), p.y(), p.z()});
  out["position_covariance_m2"] = opportunistic_matrix(found->position_covariance_m2);
  return out;
}

std::vector<OpportunisticObservation> opportunistic_observations(const TableBase& rows) {
  std::vector<OpportunisticObservation> observed(rows.rows());
  for (std::size_t i = 0; i < observed.size(); ++i) {
    const auto row = rows.row(i);
    auto& o = observed[i];
    o.source = row[0] >= 0.0 && row[0] < 2e9 ? static_cast<int>(row[0]) : -1;
    o.kind = row[1] == 0.0 ? ObservableKind::kPhase : ObservableKind::kPseudorange;
    o.value = row[2];
    o.sigma = row[3];
    o.correction_m = row[4];
    o.source_position_e_m = {row[5], row[6], row[7]};
    o.source_clock_m = row[8];
  }
  return observed;
}

py::object opportunistic_expected(const OpportunisticNavigator& self, double t_s, const Table<"observation">& row) {
  double value = 0.0;
  std::vector<double> jacobian(static_cast<std::size_t>(self.dim()));
  if (!self.expected(t_s, opportunistic_observations(row).at(0), value, jacobian)) return py::none();
  return py::make_tuple(value, to_array(std::move(jacobian)));
}

py::dict opportunistic_step(OpportunisticNavigator& self, double t_s, const Table<"observations">& rows) {
  const std::vector<OpportunisticObservation> observed = opportunistic_observations(rows);
  const auto report = self.step(t_s, observed);
  std::vector<std::uint8_t> uses;
  std::vector<double> innovation, sigma, w;
  for (const auto& r : self.reports()) {
    uses.push_back(static_cast<std::uint8_t>(r.use));
    innovation.push_back(r.innovation);
    sigma.push_back(r.sigma);
    w.push_back(r.w);
  }
  uses.resize(observed.size(), static_cast<std::uint8_t>(ObservableUse::kTooMany));
  for (auto* series : {&innovation, &sigma, &w}) series->resize(observed.size(), std::nan(""));
  py::dict out;
  out["status"] = std::string(to_string(report.status));
  out["uses"] = to_array(std::move(uses));
  out["innovations"] = to_array(std::move(innovation));
  out["sigmas"] = to_array(std::move(sigma));
  out["w"] = to_array(std::move(w));
  out["accepted"] = report.accepted;
  out["rejected"] = report.rejected;
  out["slips"] = report.slips;
  out["source_jumps"] = report.source_jumps;
  out["receiver_jump"] = report.receiver_jump;
  out["nis"] = report.nis;
  out["dof"] = report.dof;
  return out;
}

py::dict opportunistic_run(OpportunisticNavigator& self, const RealArray<"t_s">& t_s, const std::vector<int>& sources,
                           const Numbers<"phase_cycles">& phase, const Numbers<"phase_sigma_cycles">& phase_sigma,
                           const Numbers<"pseudorange_m">& pseudorange,
                           const Numbers<"pseudorange_sigma_m">& pseudorange_sigma,
                           const Numbers<"phase_correction_m">& phase_correction,
                           const Numbers<"range_correction_m">& range_correction,
                           const Numbers<"source_position_e_m">& source_position,
                           const Numbers<"source_clock_s">& source_clock, bool record, bool covariance) {
  OpportunisticBatch in;
  in.t_s = t_s.span();
  in.sources = sources;
  in.phase_cycles = phase.span();
  in.phase_sigma_cycles = phase_sigma.span();
  in.pseudorange_m = pseudorange.span();
  in.pseudorange_sigma_m = pseudorange_sigma.span();
  in.phase_correction_m = phase_correction.span();
  in.range_correction_m = range_correction.span();
  in.source_position_e_m = source_position.span();
  in.source_clock_m = source_clock.span();
  in.covariance = covariance;
  navigation::OpportunisticRun run;
  {
    const py::gil_scoped_release release;
    run = self.run(in, record);
  }
  const auto n = static_cast<py::ssize_t>(in.t_s.size());
  const auto s = static_cast<py::ssize_t>(in.sources.size());
  const py::ssize_t d = run.dim;
  std::vector<std::uint8_t> status;
  for (const UpdateStatus one : run.status) status.push_back(static_cast<std::uint8_t>(one));
  py::dict out;
  out["mean"] = to_array(std::move(run.mean), {n, d});
  out["sigma"] = to_array(std::move(run.sigma), {n, d});
  out["covariance"] = covariance ? py::object(to_array(std::move(run.covariance), {n, d, d})) : py::none();
  out["phase_use"] = to_array(std::move(run.phase_use), {n, s});
  out["pseudorange_use"] = to_array(std::move(run.pseudorange_use), {n, s});
  out["phase_innovation_cycles"] = to_array(std::move(run.phase_innovation_cycles), {n, s});
  out["pseudorange_innovation_m"] = to_array(std::move(run.pseudorange_innovation_m), {n, s});
  out["nis"] = to_array(std::move(run.nis));
  out["dof"] = to_array(std::move(run.dof));
  out["receiver_jump"] = to_array(std::move(run.receiver_jump)).attr("view")("bool");
  out["status"] = to_array(std::move(status));
  return out;
}

void register_opportunistic_smoother(py::module_& m) {
  py::class_<OpportunisticSmoother>(m, "_OpportunisticSmoother", "Arrays of a smoothed run.")
      .def("t_s",
           [](const OpportunisticSmoother& self) {
             return to_array(std::vector<double>(self.t_s().begin(), self.t_s().end()));
           })
      .def_property_readonly("names", &OpportunisticSmoother::component_names)
      .def_property_readonly("sources", &OpportunisticSmoother::component_sources)
      .def("mean",
           [](const OpportunisticSmoother& self) {
             return to_array(self.mean(), {self.epochs(), static_cast<py::ssize_t>(self.component_names().size())});
           })
      .def("sigma",
           [](const OpportunisticSmoother& self) {
             return to_array(self.sigma(), {self.epochs(), static_cast<py::ssize_t>(self.component_names().size())});
           })
      .def(
          "covariance",
          [](const OpportunisticSmoother& self, const std::vector<int>& components) {
            const auto k = static_cast<py::ssize_t>(components.size());
            return to_array(self.covariance(components), {self.epochs(), k, k});
          },
          py::arg("components"))
      .def(
          "lag_covariance",
          [](const OpportunisticSmoother& self, int component, int max_lag) {
            std::vector<double> out;
            {
              const py::gil_scoped_release release;
              out = self.lag_covariance(component, max_lag);
            }
            return to_array(std::move(out), {self.epochs(), static_cast<py::ssize_t>(max_lag) + 1});
          },
          py::arg("component"), py::arg("max_lag"));
}

}  // namespace

void register_opportunistic(py::module_& m) {
  py::native_enum<ObservableUse>(m, "ObservableUse", "enum.IntEnum", "What became of an observable.")
      .value("MISSING", ObservableUse::kMissing)
      .value("ACCEPTED", ObservableUse::kAccepted)
      .value("SLIP", ObservableUse::kSlip)
      .value("GATED", ObservableUse::kGated)
      .value("SUSPENDED", ObservableUse::kSuspended)
      .value("UNKNOWN_SOURCE", ObservableUse::kUnknownSource)
      .value("NON_FINITE", ObservableUse::kNonFinite)
      .value("UNDEFINED", ObservableUse::kUndefined)
      .value("NOT_POSITIVE_DEFINITE", ObservableUse::kNotPositiveDefinite)
      .value("TOO_MANY", ObservableUse::kTooMany)
      .finalize();
  register_opportunistic_smoother(m);
  using Self = OpportunisticNavigator;
  py::class_<Self>(m, "_OpportunisticNavigator", "The engine of `OpportunisticNavigator`.")
      .def(py::init(&opportunistic_make), py::kw_only(), py::arg("position"), py::arg("position_covariance"),
           py::arg("velocity"), py::arg("velocity_covariance"), py::arg("clock_bias_m"), py::arg("clock_drift_mps"),
           py::arg("clock_covariance"), py::arg("clock"), py::arg("motion"), py::arg("form"), py::arg("time_tag"),
           py::arg("position_walk_m2ps"), py::arg("acceleration_psd_m2ps3"), py::arg("max_sources"),
           py::arg("max_observables"), py::arg("fault_probability"), py::arg("suspend_share"),
           py::arg("suspend_memory"))
      .def("add_source", &opportunistic_add, py::kw_only(), py::arg("name"), py::arg("carrier_hz"), py::arg("orbit"),
           py::arg("position"), py::arg("position_covariance"), py::arg("clock"), py::arg("clock_bias_m"),
           py::arg("clock_drift_mps"), py::arg("clock_epoch_s"), py::arg("clock_covariance"),
           py::arg("ambiguity_estimated"), py::arg("ambiguity_cycles"), py::arg("ambiguity_sigma_cycles"),
           py::arg("ambiguity_walk_cycles2ps"), py::arg("position_walk_m2ps"))
      .def("remove_source", &Self::remove_source, py::arg("source"))
      .def("sources", &Self::sources)
      .def(
          "find_source", [](const Self& self, const std::string& name) { return self.find_source(name); },
          py::arg("name"))
      .def("source", &opportunistic_source, py::arg("source"))
      .def("step", &opportunistic_step, py::arg("t_s"), py::arg("observations"))
      .def("expected", &opportunistic_expected, py::arg("t_s"), py::arg("observation"))
      .def("run", &opportunistic_run, py::kw_only(), py::arg("t_s"), py::arg("sources"), py::arg("phase"),
           py::arg("phase_sigma"), py::arg("pseudorange"), py::arg("pseudorange_sigma"), py::arg("phase_correction"),
           py::arg("range_correction"), py::arg("source_position"), py::arg("source_clock"), py::arg("record"),
           py::arg("covariance"))
      .def("start_recording", &Self::start_recording, py::arg("epochs"))
      .def_property_readonly("recorded", &Self::recorded)
      .def("smooth", &Self::smooth, py::arg("gains"), py::call_guard<py::gil_scoped_release>())
      .def("open_ambiguity", &Self::open_ambiguity, py::arg("source"), py::arg("sigma_cycles"))
      .def("open_clock", &Self::open_clock, py::arg("source"), py::arg("bias_sigma_m"), py::arg("drift_sigma_mps"))
      .def(
          "set_clock_noise",
          [](Self& self, int source, double white, double walk) {
            return self.set_clock_noise(source, {white, walk});
          },
          py::arg("source"), py::arg("white_frequency_m2ps"), py::arg("frequency_walk_m2ps3"))
      .def("readmit", &Self::readmit, py::arg("source"))
      .def("unobservable", &Self::unobservable, py::arg("epochs"), py::arg("tolerance"))
      .def("component_names", &Self::component_names)
      .def("mean",
           [](const Self& self) {
             const Eigen::VectorXd x = self.mean();
             return to_array(std::vector<double>(x.data(), x.data() + x.size()));
           })
      .def("covariance", [](const Self& self) { return opportunistic_matrix(self.covariance()); })
      .def_property_readonly("t_s", &Self::t_s)
      .def("position",
           [](const Self& self) {
             const Eigen::Vector3d p = self.position_e_m();
             return to_array(std::vector<double>{p.x(), p.y(), p.z()});
           })
      .def("position_covariance", [](const Self& self) { return opportunistic_matrix(self.position_covariance_m2()); })
      .def_property_readonly("clock_bias_m", &Self::clock_bias_m)
      .def_property_readonly("clock_drift_mps", &Self::clock_drift_mps)
      .def("clock_covariance", [](const Self& self) { return opportunistic_matrix(self.clock_covariance()); });
}

}  // namespace soopnav::python
