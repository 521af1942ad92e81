#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "particle_cloud.hpp"
#include "register.hpp"

namespace soopnav::python {

namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Models = std::vector<const AnyMeasurement*>;
using Mask = py::array_t<std::uint8_t, py::array::c_style | py::array::forcecast>;
/// Models, z, variances of each row, covariance in place of them, probability and density of outliers.
using ObservationTuple =
    std::tuple<Models, Numbers<"z">, std::optional<Numbers<"sigma">>, std::optional<Numbers<"R">>, double, double>;
/// The same over time, and where there are measurements.
using RunTuple = std::tuple<Models, Numbers<"z">, std::optional<Numbers<"sigma">>, std::optional<Numbers<"R">>, bool,
                            std::optional<Mask>, double, double>;

Eigen::VectorXd vector(const NumbersBase& numbers) {
  return Eigen::Map<const Eigen::VectorXd>(numbers.span().data(), static_cast<Eigen::Index>(numbers.span().size()));
}
RowMajor square(const NumbersBase& numbers) {
  numbers.require_axes({2}, "a matrix");
  return Eigen::Map<const RowMajor>(numbers.span().data(), numbers.shape()[0], numbers.shape()[1]);
}

std::vector<Observations> observations_of(const std::vector<ObservationTuple>& tuples) {
  std::vector<Observations> all;
  for (const auto& [models, z, variances, R, probability, density] : tuples) {
    Observations o{models, vector(z), {}, {}, probability, density};
    if (variances) o.variances = vector(*variances);
    if (R) o.R = square(*R);
    all.push_back(std::move(o));
  }
  return all;
}

ParticlePrior gaussian(const Numbers<"x0">& x0, const Numbers<"P0">& P0) {
  ParticlePrior prior;
  prior.x0 = vector(x0);
  prior.P0 = square(P0);
  return prior;
}
ParticlePrior uniform(const Numbers<"low">& low, const Numbers<"high">& high) {
  ParticlePrior prior;
  prior.low = vector(low);
  prior.high = vector(high);
  return prior;
}
ParticlePrior samples(const Numbers<"particles">& particles) {
  ParticlePrior prior;
  prior.samples = square(particles);
  return prior;
}

/// Name, roles and component names of a state; `names` are those of a custom one.
void set_state(CloudSettings& settings, const std::string& state, std::size_t size,
               const std::optional<std::vector<std::string>>& names) {
  with_state(state, size, [&settings]<class State>(std::type_identity<State>) {
    settings.state = kStateName<State>;
    settings.roles = role_map<State>();
    settings.names = component_names<State>();
    return 0;
  });
  if (names) settings.names = *names;
}

std::unique_ptr<ParticleCloud> make_cloud(const ParticlePrior& prior, const std::string& state, std::size_t size,
                                          const std::optional<std::vector<std::string>>& names, std::size_t count,
                                          std::uint64_t seed, int threads, Resampling resampling, double ess_threshold,
                                          bool single, bool restart, bool portable, bool auxiliary,
                                          double regularisation, const AdaptiveCount& adaptive,
                                          bool marginalized_clock) {
  CloudSettings settings;
  set_state(settings, state, size, names);
  settings.options = {.count = count,
                      .seed = seed,
                      .threads = threads,
                      .resampling = resampling,
                      .ess_threshold = ess_threshold,
                      .auxiliary = auxiliary,
                      .regularisation = regularisation,
                      .adaptive = adaptive,
                      .portable_kernels = portable};
  if (marginalized_clock) {
    for (const int column : {settings.roles.clock_bias, settings.roles.clock_drift}) {
      if (column >= 0) settings.clock.push_back(column);
    }
    if (settings.clock.empty())
      throw py::value_error("marginalized_clock: the state '" + settings.state + "' has no clock");
  }
  settings.single = single;
  settings.restart = restart;
  const py::gil_scoped_release release;
  return ParticleCloud::make(std::move(settings), prior);
}

py::tuple run(ParticleCloud& cloud, const Numbers<"time_s">& time_s, std::optional<double> start_s,
              std::optional<const AnyProcess*> process, const std::optional<Numbers<"inputs">>& inputs,
              const std::vector<RunTuple>& measurements, bool covariance) {
  std::vector<RunObservations> all;
  for (const auto& [models, z, variances, R, each, mask, probability, density] : measurements) {
    RunObservations o;
    o.models = models;
    o.z = z.span();
    o.noise = R ? R->span() : variances->span();
    o.full = R.has_value();
    o.each = each;
    if (mask) o.present = {mask->data(), static_cast<std::size_t>(mask->size())};
    o.probability = probability;
    o.density = density;
    all.push_back(std::move(o));
  }
  CloudRun result;
  {
    const py::gil_scoped_release release;
    result = cloud.run(time_s.span(), start_s, process.value_or(nullptr),
                       inputs ? inputs->span() : std::span<const double>{}, all, covariance);
  }
  const auto steps = static_cast<py::ssize_t>(result.ess.size());
  const auto n = static_cast<py::ssize_t>(cloud.size());
  py::object P = py::none();
  if (covariance) P = to_array(std::move(result.covariance), {steps, n, n});
  return py::make_tuple(to_array(std::move(result.mean), {steps, n}), std::move(P), to_array(std::move(result.ess)),
                        to_array(std::move(result.log_likelihood)), to_array(std::move(result.status)),
                        to_array(std::move(result.resampled)), to_array(std::move(result.count)));
}

// A function of the cloud's that returns numbers, without the GIL.
template <class F>
auto released(const F& f) {
  const py::gil_scoped_release release;
  return f();
}

py::array_t<double> columns(std::vector<double>&& components, std::size_t size) {
  const auto n = static_cast<py::ssize_t>(components.size() / size);
  return py::array_t<double>(
      py::object(to_array(std::move(components), {static_cast<py::ssize_t>(size), n}).attr("T")));
}

}  // namespace

void register_particle(py::module_& m) {
  static_assert(std::is_same_v<std::underlying_type_t<ParticleStatus>, std::uint8_t>);
  py::native_enum<ParticleStatus>(m, "ParticleStatus", "enum.IntEnum", "What became of a call to a particle filter.")
      .value("ACCEPTED", ParticleStatus::kAccepted)
      .value("DEGENERATE", ParticleStatus::kDegenerate)
      .value("NON_FINITE", ParticleStatus::kNonFinite)
      .value("NOT_POSITIVE_DEFINITE", ParticleStatus::kNotPositiveDefinite)
      .value("TOO_MANY_ROWS", ParticleStatus::kTooManyRows)
      .value("TIME_NOT_ADVANCING", ParticleStatus::kTimeNotAdvancing)
      .finalize();
  py::native_enum<Resampling>(m, "Resampling", "enum.Enum", "How offspring are drawn from weights.")
      .value("MULTINOMIAL", Resampling::kMultinomial)
      .value("RESIDUAL", Resampling::kResidual)
      .value("STRATIFIED", Resampling::kStratified)
      .value("SYSTEMATIC", Resampling::kSystematic)
      .value("NEAREST", Resampling::kNearest)
      .finalize();

  py::class_<ParticleReport>(m, "ParticleReport", "What a prediction, update or step of a particle filter reports.")
      .def_readonly("status", &ParticleReport::status, "ParticleStatus")
      .def_readonly(
          "log_likelihood", &ParticleReport::log_likelihood,
          "Of the measurement given those before; 0 for a prediction, -inf when degenerate, NaN when refused.")
      .def_readonly("ess", &ParticleReport::ess, "Effective sample size after the call, 1 ... count.")
      .def_readonly("resampled", &ParticleReport::resampled, "Whether the call began by resampling.")
      .def_property_readonly("accepted", &ParticleReport::accepted)
      .def(py::pickle(
          [](const ParticleReport& r) {
            return py::make_tuple(static_cast<int>(r.status), r.log_likelihood, r.ess, r.resampled);
          },
          [](const py::tuple& t) {
            if (t.size() != 4) throw py::value_error("ParticleReport: four items expected");
            return ParticleReport{static_cast<ParticleStatus>(t[0].cast<int>()), t[1].cast<double>(),
                                  t[2].cast<double>(), t[3].cast<bool>()};
          }))
      .def("__repr__", [](const ParticleReport& r) {
        return py::str("ParticleReport({}, log-likelihood {:.6g}, ess {:.6g}{})")
            .format(std::string(to_string(r.status)), r.log_likelihood, r.ess, r.resampled ? ", resampled" : "");
      });

  m.def(
      "joined_report",
      [](ParticleReport report, bool resampled) {
        report.resampled = report.resampled || resampled;
        return report;
      },
      py::arg("report"), py::arg("resampled"), "The report of a weighing that followed a prediction.");

  py::class_<AdaptiveCount>(m, "AdaptiveCount", "A number of particles that follows the spread of the cloud.")
      .def(
          py::init([](const Numbers<"bin_sizes">& bin_sizes, std::size_t least, double divergence, double probability) {
            const std::span<const double> sizes = bin_sizes.span();
            return AdaptiveCount{{sizes.begin(), sizes.end()}, least, divergence, probability};
          }),
          py::arg("bin_sizes"), py::arg("least"), py::arg("divergence"), py::arg("probability"));

  py::class_<ParticlePrior>(m, "ParticlePrior", "Where particles are drawn from.");
  m.def("gaussian_prior", &gaussian, py::arg("x0"), py::arg("P0"));
  m.def("uniform_prior", &uniform, py::arg("low"), py::arg("high"));
  m.def("sample_prior", &samples, py::arg("particles"));

  py::class_<ParticleCloud>(m, "ParticleCloud", "A particle filter of a state chosen at run time.")
      .def(py::init(&make_cloud), py::arg("prior"), py::kw_only(), py::arg("state"), py::arg("size"), py::arg("names"),
           py::arg("count"), py::arg("seed"), py::arg("threads"), py::arg("resampling"), py::arg("ess_threshold"),
           py::arg("single"), py::arg("restart"), py::arg("portable"), py::arg("auxiliary"), py::arg("regularisation"),
           py::arg("adaptive"), py::arg("marginalized_clock"))
      .def_property_readonly("count", [](const ParticleCloud& c) { return released([&] { return c.count(); }); })
      .def_property_readonly("state", [](const ParticleCloud& c) { return c.settings().state; })
      .def_property_readonly("component_names", [](const ParticleCloud& c) { return c.settings().names; })
      .def(
          "step",
          [](ParticleCloud& c, std::optional<const AnyProcess*> process, const std::optional<Numbers<"input">>& input,
             double dt_s, const std::vector<ObservationTuple>& observations) {
            const std::vector<Observations> all = observations_of(observations);
            return released([&] {
              return c.step(process.value_or(nullptr), input ? input->span() : std::span<const double>{}, dt_s, all);
            });
          },
          py::arg("process"), py::arg("input"), py::arg("dt_s"), py::arg("observations"))
      .def(
          "step_to",
          [](ParticleCloud& c, const Numbers<"x_next">& next, const std::vector<ObservationTuple>& observations) {
            const std::vector<Observations> all = observations_of(observations);
            return released([&] { return c.step_to(next.span(), all); });
          },
          py::arg("x_next"), py::arg("observations"))
      .def(
          "update",
          [](ParticleCloud& c, const std::vector<ObservationTuple>& observations) {
            const std::vector<Observations> all = observations_of(observations);
            return released([&] { return c.update(all); });
          },
          py::arg("observations"))
      .def(
          "reweight",
          [](ParticleCloud& c, const Numbers<"log_likelihood">& log_likelihood, bool may_resample) {
            return released([&] { return c.reweight(log_likelihood.span(), may_resample); });
          },
          py::arg("log_likelihood"), py::arg("may_resample"))
      .def(
          "constrain",
          [](ParticleCloud& c, const std::optional<Numbers<"walls">>& walls,
             const std::optional<Numbers<"inside">>& inside) {
            Constraints constraints;
            if (walls) {
              const std::span<const double> w = walls->span();
              for (std::size_t i = 0; i + 4 <= w.size(); i += 4) {
                constraints.walls.walls.push_back({{w[i], w[i + 1]}, {w[i + 2], w[i + 3]}});
              }
            }
            if (inside) {
              const std::span<const double> b = inside->span();
              for (std::size_t i = 0; i + 2 <= b.size(); i += 2) {
                constraints.low.push_back(b[i]);
                constraints.high.push_back(b[i + 1]);
              }
            }
            return released([&] { return c.constrain(std::move(constraints)); });
          },
          py::arg("walls"), py::arg("inside"))
      .def("resample", &ParticleCloud::resample, py::call_guard<py::gil_scoped_release>())
      .def("next_particles",
           [](ParticleCloud& c) {
             std::vector<double> rows = released([&] { return c.next_particles(); });
             const std::size_t count = rows.size() / c.size();
             return to_array(std::move(rows), {static_cast<py::ssize_t>(count), static_cast<py::ssize_t>(c.size())});
           })
      .def(
          "next_noise",
          [](ParticleCloud& c, std::size_t numbers) {
            std::vector<double> rows = released([&] { return c.next_noise(numbers); });
            const std::size_t count = numbers == 0 ? c.count() : rows.size() / numbers;
            return to_array(std::move(rows), {static_cast<py::ssize_t>(count), static_cast<py::ssize_t>(numbers)});
          },
          py::arg("numbers"))
      .def("run", &run, py::arg("time_s"), py::arg("start_s"), py::arg("process"), py::arg("inputs"),
           py::arg("measurements"), py::arg("covariance"))
      .def_property_readonly("mean",
                             [](const ParticleCloud& c) {
                               const Eigen::VectorXd x = released([&] { return c.mean(); });
                               return to_array(std::vector<double>(x.begin(), x.end()));
                             })
      .def_property_readonly(
          "covariance",
          [](const ParticleCloud& c) {
            const Eigen::MatrixXd P = released([&] { return c.covariance(); });
            return to_array(std::vector<double>(P.data(), P.data() + P.size()), {P.rows(), P.cols()});
          })
      .def_property_readonly("ess", [](const ParticleCloud& c) { return released([&] { return c.ess(); }); })
      .def_property_readonly("log_likelihood",
                             [](const ParticleCloud& c) { return released([&] { return c.log_likelihood(); }); })
      .def_property_readonly("storage_bytes",
                             [](const ParticleCloud& c) { return released([&] { return c.storage_bytes(); }); })
      .def_property_readonly(
          "particles",
          [](const ParticleCloud& c) { return columns(released([&] { return c.particles(); }), c.size()); })
      .def_property_readonly("weights",
                             [](const ParticleCloud& c) { return to_array(released([&] { return c.weights(); })); })
      .def(
          "histogram",
          [](const ParticleCloud& c, int component, double low, double high, std::size_t bins) {
            std::vector<double> weights(bins);
            released([&] { return c.histogram(component, low, high, weights); });
            return to_array(std::move(weights));
          },
          py::arg("component"), py::arg("low"), py::arg("high"), py::arg("bins"))
      .def("save",
           [](const ParticleCloud& c) {
             CloudSnapshot s = released([&] { return c.save(); });
             return py::make_tuple(columns(std::move(s.components), c.size()), to_array(std::move(s.log_weights)),
                                   s.log_likelihood, s.steps, s.restarts, to_array(std::move(s.clock_covariance)));
           })
      .def(
          "restore",
          [](ParticleCloud& c, const Numbers<"particles">& particles, const Numbers<"log_weights">& log_weights,
             double log_likelihood, std::uint64_t steps, std::uint64_t restarts,
             const Numbers<"clock_covariance">& clock_covariance) {
            CloudSnapshot s;
            const std::size_t size = c.size();
            const std::size_t count = log_weights.span().size();
            const std::span<const double> rows = particles.span();
            if (rows.size() != count * size) throw py::value_error("particles: wrong shape");
            s.components.resize(rows.size());
            for (std::size_t i = 0; i < count; ++i) {
              for (std::size_t k = 0; k < size; ++k) s.components[k * count + i] = rows[i * size + k];
            }
            s.log_weights.assign(log_weights.span().begin(), log_weights.span().end());
            s.log_likelihood = log_likelihood;
            s.steps = steps;
            s.restarts = restarts;
            s.clock_covariance.assign(clock_covariance.span().begin(), clock_covariance.span().end());
            released([&] {
              c.restore(s);
              return 0;
            });
          },
          py::arg("particles"), py::arg("log_weights"), py::arg("log_likelihood"), py::arg("steps"),
          py::arg("restarts"), py::arg("clock_covariance"));
}

}  // namespace soopnav::python
