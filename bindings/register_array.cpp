#include <pybind11/complex.h>
#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <complex>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "channel_arrays.hpp"
#include "register.hpp"
#include "soopnav/array/antenna.hpp"
#include "soopnav/array/crlb.hpp"
#include "soopnav/array/direction_finder.hpp"

namespace soopnav::python {

namespace {

using array::ArrayGeometry;
using array::ArrayStatus;
using array::Bearings;
using array::Cf64;
using array::ComplexMatrix;
using array::ComplexVector;
using array::Direction;
using array::DirectionFinder;
using array::DirectionMethod;
using array::Manifold;
using array::SteeringTable;

template <class Enum, std::size_t N>
Enum of_word(const char* name, const std::string& word, const std::array<std::pair<const char*, Enum>, N>& words) {
  std::string known;
  for (const auto& [text, value] : words) {
    if (word == text) return value;
    known += (known.empty() ? "\"" : ", \"") + std::string(text) + "\"";
  }
  throw std::invalid_argument(std::string(name) + ": \"" + word + "\"; it must be one of " + known);
}

constexpr std::array<std::pair<const char*, DirectionMethod>, 5> kMethods{
    {{"music", DirectionMethod::kMusic},
     {"capon", DirectionMethod::kCapon},
     {"bartlett", DirectionMethod::kBartlett},
     {"subspace_fitting", DirectionMethod::kSubspaceFitting},
     {"maximum_likelihood", DirectionMethod::kMaximumLikelihood}}};
constexpr std::array<std::pair<const char*, array::Spectrum>, 3> kSpectra{
    {{"bartlett", array::Spectrum::kBartlett}, {"capon", array::Spectrum::kCapon}, {"music", array::Spectrum::kMusic}}};
constexpr std::array<std::pair<const char*, array::SourceCount>, 3> kCounts{
    {{"mdl", array::SourceCount::kMdl}, {"aic", array::SourceCount::kAic}, {"sorte", array::SourceCount::kSorte}}};
constexpr std::array<std::pair<const char*, array::CrlbKind>, 2> kKinds{
    {{"stochastic", array::CrlbKind::kStochastic}, {"deterministic", array::CrlbKind::kDeterministic}}};
constexpr double kHermitian = 1e-4;  // of the largest element: room for sums in single precision
constexpr const char* kRegions[] = {"near", "marginal", "far"};

ComplexMatrix square(const ComplexTableBase& table, const char* name) {
  if (table.rows() != table.columns() || table.rows() < 1 ||
      table.rows() > static_cast<std::size_t>(array::kMaxElements)) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(table.rows()) + " x " +
                                std::to_string(table.columns()) + "; a square matrix of 1 to 32 rows expected");
  }
  const auto n = static_cast<Eigen::Index>(table.rows());
  ComplexMatrix out(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) out(i, j) = table(static_cast<std::size_t>(i), static_cast<std::size_t>(j));
  }
  return out;
}

/// A covariance: estimators read one triangle of it, so that the other must not say something else. NaN passes.
ComplexMatrix hermitian(const ComplexTableBase& table) {
  ComplexMatrix out = square(table, "R");
  const double apart = (out - out.adjoint()).cwiseAbs().maxCoeff(), most = out.cwiseAbs().maxCoeff();
  if (apart > kHermitian * most) {
    throw std::invalid_argument("R: R and its conjugate transpose differ by " + std::to_string(apart / most) +
                                " of its largest element; a Hermitian matrix expected");
  }
  return out;
}

py::array_t<Cf64> to_matrix(const ComplexMatrix& matrix) {
  py::array_t<Cf64> out({matrix.rows(), matrix.cols()});
  auto view = out.mutable_unchecked<2>();
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j) view(i, j) = matrix(i, j);
  }
  return out;
}

py::array_t<double> to_matrix(const Eigen::MatrixXd& matrix) {
  py::array_t<double> out({matrix.rows(), matrix.cols()});
  auto view = out.mutable_unchecked<2>();
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j) view(i, j) = matrix(i, j);
  }
  return out;
}

array::HermitianEigen eigen_of(const ComplexTableBase& table) {
  array::HermitianEigen eigen;
  if (!array::hermitian_eigen(hermitian(table), eigen)) {
    throw std::invalid_argument("R: NaN or infinity; a finite covariance expected");
  }
  return eigen;
}

void require_ok(ArrayStatus status, const char* rule) {
  if (status != ArrayStatus::kOk) {
    throw std::invalid_argument("R: " + std::string(array::to_string(status)) + "; " + rule);
  }
}

void require_sources(int n_sources) {
  if (n_sources < 1) {
    throw std::invalid_argument("n_sources: " + std::to_string(n_sources) +
                                "; 1 to the number of elements less one expected");
  }
}

std::vector<Direction> directions_of(const TableBase& table) {
  if (table.columns() != 2) {
    throw std::invalid_argument("directions: " + std::to_string(table.columns()) +
                                " columns; azimuth and elevation expected");
  }
  std::vector<Direction> out;
  for (std::size_t i = 0; i < table.rows(); ++i) out.push_back({table.row(i)[0], table.row(i)[1]});
  return out;
}

/// A finder that several Python threads may hold: calls wait for each other.
struct SharedFinder {
  SharedFinder(std::shared_ptr<const SteeringTable> table, const array::FinderOptions& options)
      : finder(std::move(table), options) {}
  std::mutex mutex;
  DirectionFinder finder;
};

/// Bearings of many blocks, as NumPy arrays: NaN where there is none.
class Series {
 public:
  Series(std::size_t blocks, const DirectionFinder& finder)
      : elements_(static_cast<std::size_t>(finder.table().manifold().size())),
        most_(finder.options().n_sources > 0 ? static_cast<std::size_t>(finder.options().n_sources) : elements_ - 1),
        numbers_(blocks * most_ * 4, kNan),
        covariance_(blocks * most_ * 4, kNan),
        eigenvalues_(blocks * elements_, kNan),
        noise_(blocks, kNan),
        status_(blocks),
        count_(blocks) {}

  void set(std::size_t b, const Bearings& found) {
    status_[b] = static_cast<std::uint8_t>(found.status);
    count_[b] = static_cast<std::int64_t>(found.sources.size());
    if (!found.eigenvalues.empty()) noise_[b] = found.noise;
    std::copy(found.eigenvalues.begin(), found.eigenvalues.end(), eigenvalues_.data() + b * elements_);
    for (std::size_t k = 0; k < found.sources.size(); ++k) {
      const auto& source = found.sources[k];
      double* const row = numbers_.data() + (b * most_ + k) * 4;
      row[0] = source.azimuth_rad;
      row[1] = source.elevation_rad;
      row[2] = source.power;
      row[3] = source.spectrum;
      std::copy_n(source.covariance_rad2.data(), 4, covariance_.data() + (b * most_ + k) * 4);
    }
  }

  py::tuple take() {
    const auto n = static_cast<py::ssize_t>(status_.size()), k = static_cast<py::ssize_t>(most_);
    return py::make_tuple(to_array(std::move(status_)), to_array(std::move(count_)),
                          to_array(std::move(numbers_), {n, k, 4}), to_array(std::move(covariance_), {n, k, 2, 2}),
                          to_array(std::move(eigenvalues_), {n, static_cast<py::ssize_t>(elements_)}),
                          to_array(std::move(noise_)));
  }

 private:
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  std::size_t elements_, most_;
  std::vector<double> numbers_, covariance_, eigenvalues_, noise_;
  std::vector<std::uint8_t> status_;
  std::vector<std::int64_t> count_;
};

/// What the façade makes its Bearings of.
py::tuple to_tuple(const Bearings& found) {
  const auto count = static_cast<py::ssize_t>(found.sources.size());
  py::array_t<double> numbers({count, py::ssize_t{4}});  // azimuth, elevation, power, spectrum
  py::array_t<double> covariance({count, py::ssize_t{2}, py::ssize_t{2}});
  for (py::ssize_t k = 0; k < count; ++k) {
    const auto& source = found.sources[static_cast<std::size_t>(k)];
    double* const row = numbers.mutable_data(k, 0);
    row[0] = source.azimuth_rad;
    row[1] = source.elevation_rad;
    row[2] = source.power;
    row[3] = source.spectrum;
    for (py::ssize_t i = 0; i < 4; ++i) {
      covariance.mutable_data(k, 0, 0)[i] =
          source.covariance_rad2(static_cast<Eigen::Index>(i / 2), static_cast<Eigen::Index>(i % 2));
    }
  }
  return py::make_tuple(
      found.status, found.channel, numbers, covariance,
      py::array_t<double>(static_cast<py::ssize_t>(found.eigenvalues.size()), found.eigenvalues.data()), found.noise,
      found.mirror);
}

void register_geometry_types(py::module_& m) {
  py::native_enum<ArrayStatus>(m, "ArrayStatus", "enum.IntEnum", "What became of a block of samples or a covariance.")
      .value("OK", ArrayStatus::kOk)
      .value("NON_FINITE", ArrayStatus::kNonFinite)
      .value("DEAD_CHANNEL", ArrayStatus::kDeadChannel)
      .value("TOO_FEW_SNAPSHOTS", ArrayStatus::kTooFewSnapshots)
      .value("SINGULAR", ArrayStatus::kSingular)
      .value("NO_SOURCE", ArrayStatus::kNoSource)
      .value("UNRESOLVED", ArrayStatus::kUnresolved)
      .value("WRONG_SIZE", ArrayStatus::kWrongSize)
      .finalize();

  py::class_<ArrayGeometry>(m, "ArrayGeometry", "Where the elements of an array are, and its frequency. Read-only.")
      .def(py::init([](const Table<"positions_m">& positions, double frequency_hz, const std::string& name) {
             if (positions.columns() != 2 && positions.columns() != 3) {
               throw std::invalid_argument("positions_m: " + std::to_string(positions.columns()) +
                                           " columns; 2 or 3 expected");
             }
             std::vector<Eigen::Vector3d> points;
             for (std::size_t i = 0; i < positions.rows(); ++i) {
               const auto row = positions.row(i);
               points.emplace_back(row[0], row[1], row.size() > 2 ? row[2] : 0.0);
             }
             return ArrayGeometry(std::move(points), frequency_hz, name);
           }),
           py::arg("positions_m"), py::arg("frequency_hz"), py::arg("name") = "",
           "2 to 32 elements, shape (M, 3) or (M, 2), array axes [m]. Raises ValueError for two on one point, a number "
           "that is not finite, or a frequency that is not positive.")
      .def_static("ula", &ArrayGeometry::ula, py::arg("n"), py::arg("spacing_wavelengths") = 0.5, py::kw_only(),
                  py::arg("frequency_hz") = 1575.42e6, "n elements on axis 1, the first at the origin.")
      .def_static("uca", &ArrayGeometry::uca, py::arg("n"), py::arg("radius_wavelengths"), py::kw_only(),
                  py::arg("frequency_hz") = 1575.42e6,
                  "n elements on a circle round the origin in plane 1-2, the first on axis 1.")
      .def_static("planar", &ArrayGeometry::planar, py::arg("nx"), py::arg("ny"), py::arg("spacing_wavelengths") = 0.5,
                  py::kw_only(), py::arg("frequency_hz") = 1575.42e6,
                  "nx by ny elements in plane 1-2, the first at the origin, axis 1 running faster.")
      .def_property_readonly(
          "positions_m",
          [](const ArrayGeometry& g) {
            py::array_t<double> out({py::ssize_t{g.size()}, py::ssize_t{3}});
            for (py::ssize_t i = 0; i < g.size(); ++i) {
              for (py::ssize_t c = 0; c < 3; ++c) {
                out.mutable_at(i, c) = g.positions_m()[static_cast<std::size_t>(i)][c];
              }
            }
            return out;
          },
          "(M, 3), array axes [m].")
      .def_property_readonly("frequency_hz", &ArrayGeometry::frequency_hz, "Carrier.")
      .def_property_readonly("wavelength_m", &ArrayGeometry::wavelength_m, "c / frequency_hz.")
      .def_property_readonly("name", &ArrayGeometry::name, "For people.")
      .def_property_readonly("aperture_m", &ArrayGeometry::aperture_m, "Greatest distance of two elements.")
      .def_property_readonly("smallest_spacing_m", &ArrayGeometry::smallest_spacing_m, "Smallest distance of two.")
      .def_property_readonly("rank", &ArrayGeometry::rank, "1 line, 2 plane, 3 space.")
      .def_property_readonly("ambiguous", &ArrayGeometry::ambiguous, "Whether regions of directions have doubles.")
      .def(
          "ambiguous_directions",
          [](const ArrayGeometry& g, double azimuth, double elevation) {
            const auto found = g.ambiguous_directions({azimuth, elevation});
            py::array_t<double> out({static_cast<py::ssize_t>(found.size()), py::ssize_t{2}});
            for (std::size_t i = 0; i < found.size(); ++i) {
              out.mutable_at(static_cast<py::ssize_t>(i), 0) = found[i].azimuth_rad;
              out.mutable_at(static_cast<py::ssize_t>(i), 1) = found[i].elevation_rad;
            }
            return out;
          },
          py::arg("azimuth_rad"), py::arg("elevation_rad") = 0.0,
          "Other directions with the same steering vector up to its phase, shape (n, 2) [rad]; the mirror image is "
          "left out.")
      .def("__len__", &ArrayGeometry::size)
      .def("__repr__", [](const ArrayGeometry& g) {
        char text[160];
        std::snprintf(text, sizeof text, "ArrayGeometry(%s%s%d elements, %.6g MHz, aperture %.3g wavelengths, rank %d)",
                      g.name().c_str(), g.name().empty() ? "" : ", ", g.size(), g.frequency_hz() * 1e-6,
                      g.aperture_m() / g.wavelength_m(), g.rank());
        return std::string(text);
      });

  py::class_<Manifold>(m, "Manifold", "How the elements answer a plane wave. Read-only.")
      .def(py::init<ArrayGeometry>(), py::arg("geometry"), "Isotropic elements.")
      .def_static(
          "measured",
          [](const ArrayGeometry& geometry, const RealArray<"frequency_hz">& frequency,
             const RealArray<"azimuth_rad">& azimuth, const RealArray<"elevation_rad">& elevation,
             const ComplexTable<"response">& response) {
            array::ResponseGrid grid;
            grid.frequency_hz.assign(frequency.span().begin(), frequency.span().end());
            grid.azimuth_rad.assign(azimuth.span().begin(), azimuth.span().end());
            grid.elevation_rad.assign(elevation.span().begin(), elevation.span().end());
            grid.correction.assign(response.values().begin(), response.values().end());
            return Manifold(geometry, std::move(grid));
          },
          py::arg("geometry"), py::arg("frequency_hz"), py::arg("azimuth_rad"), py::arg("elevation_rad"),
          py::arg("correction"), "Factors over the geometry's own phase, shape (F E A, M).")
      .def(
          "with_errors",
          [](const Manifold& self, const RealArray<"gain_db">& gain_db, const RealArray<"phase_rad">& phase_rad) {
            return self.with_errors(gain_db.span(), phase_rad.span());
          },
          py::arg("gain_db"), py::arg("phase_rad"), "The same array with these errors besides.")
      .def(
          "with_coupling",
          [](const Manifold& self, const ComplexTable<"coupling">& coupling) {
            return self.with_coupling(square(coupling, "coupling"));
          },
          py::arg("coupling"), "The same array behind a coupling matrix.")
      .def_property_readonly("geometry", &Manifold::geometry, "The elements.")
      .def_property_readonly("ideal", &Manifold::ideal, "Isotropic elements without errors or coupling.")
      .def("__len__", &Manifold::size)
      .def(
          "steering",
          [](const Manifold& self, const RealArray<"azimuth_rad">& azimuth, const RealArray<"elevation_rad">& elevation,
             double frequency_hz) {
            if (azimuth.size() != elevation.size()) {
              throw std::invalid_argument("elevation_rad: " + std::to_string(elevation.size()) + " values for " +
                                          std::to_string(azimuth.size()) + " azimuths; as many expected");
            }
            if (!(frequency_hz > 0.0)) frequency_hz = self.geometry().frequency_hz();
            py::array_t<Cf64> out({py::ssize_t{self.size()}, static_cast<py::ssize_t>(azimuth.size())});
            auto view = out.mutable_unchecked<2>();
            ComplexVector a;
            for (std::size_t i = 0; i < azimuth.size(); ++i) {
              const Eigen::Vector3d u = array::unit_vector({azimuth[i], elevation[i]});
              const bool finite = u.allFinite();
              if (!finite || !self.steering(u, frequency_hz, a)) {
                throw std::invalid_argument(
                    "direction " + std::to_string(i) + ": azimuth " + std::to_string(azimuth[i]) + ", elevation " +
                    std::to_string(elevation[i]) +
                    (finite ? " rad; the measured responses do not reach there" : " rad; finite angles expected"));
              }
              for (Eigen::Index k = 0; k < a.size(); ++k) view(k, static_cast<py::ssize_t>(i)) = a[k];
            }
            return out;
          },
          py::arg("azimuth_rad"), py::arg("elevation_rad"), py::arg("frequency_hz") = 0.0,
          "Steering vectors, shape (M, n), complex128.");
}

void register_finder(py::module_& m) {
  py::class_<SteeringTable, std::shared_ptr<SteeringTable>>(m, "SteeringTable",
                                                            "Steering vectors over a grid of directions. Read-only.")
      .def(py::init([](const Manifold& manifold, double azimuth_step, double elevation_step, double elevation_min,
                       double azimuth_start, double frequency_hz) {
             const py::gil_scoped_release release;
             return std::make_shared<SteeringTable>(
                 manifold,
                 array::GridOptions{azimuth_step, elevation_step, elevation_min, azimuth_start, frequency_hz});
           }),
           py::arg("manifold"), py::kw_only(), py::arg("azimuth_step_rad"), py::arg("elevation_step_rad"),
           py::arg("elevation_min_rad"), py::arg("azimuth_start_rad"), py::arg("frequency_hz"), "Made once.")
      .def_property_readonly("manifold", &SteeringTable::manifold, "The array.")
      .def_property_readonly("frequency_hz", &SteeringTable::frequency_hz, "Of the signal.")
      .def_property_readonly(
          "azimuth_rad",
          [](const SteeringTable& t) {
            return py::array_t<double>(static_cast<py::ssize_t>(t.columns()), t.azimuths_rad().data());
          },
          "Columns of the grid.")
      .def_property_readonly(
          "elevation_rad",
          [](const SteeringTable& t) {
            return py::array_t<double>(static_cast<py::ssize_t>(t.rows()), t.elevations_rad().data());
          },
          "Rows of the grid.");

  py::class_<SharedFinder>(m, "DirectionFinder", "Directions from samples.")
      .def(py::init([](const std::shared_ptr<SteeringTable>& table, const std::string& method, int n_sources,
                       double loading, bool average) {
             return std::make_unique<SharedFinder>(
                 table, array::FinderOptions{of_word("method", method, kMethods), n_sources, loading, average});
           }),
           py::arg("table"), py::kw_only(), py::arg("method"), py::arg("n_sources"), py::arg("loading"),
           py::arg("forward_backward"), "Made once.")
      .def(
          "estimate",
          [](SharedFinder& self, const ChannelArray<"iq">& iq) {
            std::unique_lock lock(self.mutex, std::defer_lock);
            Bearings found;
            {
              const py::gil_scoped_release release;
              lock.lock();
              found = self.finder.estimate({iq.data(), iq.channels(), iq.samples(), iq.samples()});
            }
            return to_tuple(found);
          },
          py::arg("iq"), "Status, channel, numbers (K, 4), covariance (K, 2, 2), eigenvalues, noise, mirror.")
      .def(
          "estimate_covariance",
          [](SharedFinder& self, const ComplexTable<"R">& table, double n_snapshots) {
            const ComplexMatrix R = hermitian(table);
            std::unique_lock lock(self.mutex, std::defer_lock);
            Bearings found;
            {
              const py::gil_scoped_release release;
              lock.lock();
              found = self.finder.estimate(R, n_snapshots);
            }
            return to_tuple(found);
          },
          py::arg("R"), py::arg("n_snapshots"), "As estimate.")
      .def(
          "track",
          [](SharedFinder& self, const ChannelArray<"iq">& iq, std::size_t block, std::size_t hop) {
            if (block < 1 || hop < 1)
              throw std::invalid_argument(std::string(block < 1 ? "block" : "hop") + ": 0; at least 1 expected");
            const std::size_t blocks = iq.samples() < block ? 0 : (iq.samples() - block) / hop + 1;
            Series series(blocks, self.finder);
            {
              const py::gil_scoped_release release;
              const std::scoped_lock lock(self.mutex);
              const array::ChannelSpan all{iq.data(), iq.channels(), iq.samples(), iq.samples()};
              for (std::size_t b = 0; b < blocks; ++b) {
                series.set(b, self.finder.estimate(all.part(b * hop, block)));
              }
            }
            return series.take();
          },
          py::arg("iq"), py::arg("block"), py::arg("hop"), "Status, count, numbers (B, K, 4), covariance, eigenvalues.")
      .def(
          "run",
          [](SharedFinder& self, const Numbers<"R">& parts, double n_snapshots) {
            // Covariances as (E, M, M, 2) numbers: real and imaginary parts.
            const std::size_t elements = static_cast<std::size_t>(self.finder.table().manifold().size());
            parts.require_axes({4}, "covariances with shape (E, M, M, 2)");
            const auto& shape = parts.shape();
            if (static_cast<std::size_t>(shape[1]) != elements || shape[2] != shape[1] || shape[3] != 2) {
              throw std::invalid_argument("R: covariances of another number of elements; " + std::to_string(elements) +
                                          " expected");
            }
            const auto epochs = static_cast<std::size_t>(shape[0]);
            Series series(epochs, self.finder);
            {
              const py::gil_scoped_release release;
              const std::scoped_lock lock(self.mutex);
              const auto n = static_cast<Eigen::Index>(elements);
              ComplexMatrix R(n, n);
              const double* next = parts.span().data();
              for (std::size_t e = 0; e < epochs; ++e) {
                for (Eigen::Index i = 0; i < n; ++i) {
                  for (Eigen::Index j = 0; j < n; ++j, next += 2) R(i, j) = Cf64(next[0], next[1]);
                }
                series.set(e, self.finder.estimate(R, n_snapshots));
              }
            }
            return series.take();
          },
          py::arg("R"), py::arg("n_snapshots"), "As track, for covariances.");
}

void register_functions(py::module_& m) {
  m.def(
      "covariance",
      [](const ChannelArray<"iq">& iq) {
        ComplexMatrix R;
        array::CovarianceReport report;
        {
          const py::gil_scoped_release release;
          report = array::covariance({iq.data(), iq.channels(), iq.samples(), iq.samples()}, R);
        }
        return py::make_tuple(report.status, report.channel, to_matrix(R));
      },
      py::arg("iq"), "Status, channel at fault, covariance.");
  m.def(
      "forward_backward", [](const ComplexTable<"R">& R) { return to_matrix(array::forward_backward(square(R, "R"))); },
      py::arg("R"), "(R + J conj(R) J) / 2.");
  m.def(
      "spatial_smoothing",
      [](const ComplexTable<"R">& R, int size, bool average) {
        return to_matrix(array::spatial_smoothing(square(R, "R"), size, average));
      },
      py::arg("R"), py::arg("subarray_size"), py::arg("forward_backward") = false, "Mean over subarrays of a ULA.");
  m.def(
      "eigenvalues",
      [](const ComplexTable<"R">& R) {
        const auto eigen = eigen_of(R);
        return py::array_t<double>(eigen.values.size(), eigen.values.data());
      },
      py::arg("R"), "Largest first.");
  m.def(
      "spectrum",
      [](const std::string& kind, const ComplexTable<"R">& R, const ComplexTable<"steering">& steering, int n_sources,
         double loading) {
        const auto eigen = eigen_of(R);
        if (steering.rows() != R.rows()) {
          throw std::invalid_argument("steering: " + std::to_string(steering.rows()) + " rows; " +
                                      std::to_string(R.rows()) + " expected, one per element");
        }
        std::vector<double> out(steering.columns());
        const auto status =
            array::spectrum(of_word("kind", kind, kSpectra), eigen, steering.values(), n_sources, loading, out);
        require_ok(status, "its rank is too low for this spectrum (Capon: give a loading)");
        return to_array(std::move(out));
      },
      py::arg("kind"), py::arg("R"), py::arg("steering"), py::arg("n_sources") = 1, py::arg("loading") = 0.0,
      "Bartlett, Capon or MUSIC spectrum, shape (G,).");
  m.def(
      "root_music",
      [](const ComplexTable<"R">& R, int n_sources, double spacing) {
        require_sources(n_sources);
        std::vector<double> out(static_cast<std::size_t>(n_sources));
        require_ok(array::root_music(eigen_of(R), spacing, out), "a rank of at least n_sources expected");
        return to_array(std::move(out));
      },
      py::arg("R"), py::arg("n_sources"), py::kw_only(), py::arg("spacing_wavelengths") = 0.5, "Angles, ascending.");
  m.def(
      "esprit",
      [](const ComplexTable<"R">& R, int n_sources, double spacing, bool total) {
        require_sources(n_sources);
        std::vector<double> out(static_cast<std::size_t>(n_sources));
        require_ok(array::esprit(eigen_of(R), spacing, total, out), "a rank of at least n_sources expected");
        return to_array(std::move(out));
      },
      py::arg("R"), py::arg("n_sources"), py::kw_only(), py::arg("spacing_wavelengths") = 0.5,
      py::arg("total_least_squares") = true, "Angles, ascending.");
  m.def(
      "source_count",
      [](const RealArray<"eigenvalues">& eigenvalues, double n_snapshots, const std::string& method) {
        return array::source_count(of_word("method", method, kCounts), eigenvalues.span(), n_snapshots);
      },
      py::arg("eigenvalues"), py::arg("n_snapshots"), py::arg("method") = "mdl", "Number of sources, or -1.");
  m.def(
      "crlb",
      [](const Manifold& manifold, const Table<"directions">& directions, const ComplexTable<"powers">& powers,
         double noise, double n_snapshots, const std::string& kind, bool azimuth_only) {
        const auto at = directions_of(directions);
        const auto which = of_word("kind", kind, kKinds);
        const ComplexMatrix S = square(powers, "powers");
        return to_matrix(azimuth_only ? array::azimuth_crlb(manifold, at, S, noise, n_snapshots, which)
                                      : array::crlb(manifold, at, S, noise, n_snapshots, which));
      },
      py::arg("manifold"), py::arg("directions"), py::arg("powers"), py::arg("noise"), py::arg("n_snapshots"),
      py::arg("kind"), py::arg("azimuth_only"), "Covariance bound [rad^2].");
  m.def(
      "polarization_factor",
      [](double tilt_a, double ellipticity_a, double tilt_b, double ellipticity_b) {
        return array::polarization_factor({tilt_a, ellipticity_a}, {tilt_b, ellipticity_b});
      },
      py::arg("tilt_a_rad"), py::arg("ellipticity_a_rad"), py::arg("tilt_b_rad"), py::arg("ellipticity_b_rad"),
      "p of carter (4.8).");
  m.def("impedance_factor", &array::impedance_factor, py::arg("antenna_ohm"), py::arg("load_ohm"),
        "q of carter (4.8).");
  m.def("received_power_dbm", &array::received_power_dbm, py::arg("transmit_power_dbm"), py::arg("transmit_gain_db"),
        py::arg("receive_gain_db"), py::arg("distance_m"), py::arg("frequency_hz"), py::arg("polarization") = 1.0,
        py::arg("impedance") = 1.0, "carter (4.8).");
  m.def(
      "far_field",
      [](double aperture_m, double wavelength_m) {
        const auto far = array::far_field(aperture_m, wavelength_m);
        return py::make_tuple(far.radiating_m, far.phase_m, far.amplitude_m);
      },
      py::arg("aperture_m"), py::arg("wavelength_m"), "Limits of carter (4.1), (4.2), (4.3).");
  m.def(
      "field_region",
      [](double aperture_m, double wavelength_m, double distance_m) {
        return kRegions[static_cast<int>(array::far_field(aperture_m, wavelength_m).region(distance_m))];
      },
      py::arg("aperture_m"), py::arg("wavelength_m"), py::arg("distance_m"), "near, marginal or far.");
}

}  // namespace

void register_array(py::module_& m) {
  register_geometry_types(m);
  register_finder(m);
  register_functions(m);
}

}  // namespace soopnav::python
