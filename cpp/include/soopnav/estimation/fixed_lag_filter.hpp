#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <concepts>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "soopnav/core/epoch.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/rts_smoother.hpp"
#include "soopnav/estimation/transition.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav {

/// Any filter over a fixed state, with late measurements: an observation that arrives after younger ones is put where
/// it belongs, and what came after it is done again.
///
/// Kept are the last `capacity` events (inputs and observations with their epochs) and the filter after each. The
/// filter at any time is that of the events in order of their epochs, those of one epoch in order of arrival, to the
/// bit the same as if they had arrived so. Between events the process moves the filter under the input in force: an
/// input holds from its epoch to the next.
///
/// An observation that the filter refuses (gated, undefined) is an event nevertheless: time has advanced to it, and it
/// is judged anew when an older one comes in. One refused for itself (not finite, R not positive definite, too late,
/// wrong time scale) changes nothing and is not kept. A process that is undefined or overflows leaves the filter at the
/// event before.
///
/// Copies filters: `Filter` may be any that linearises or draws sigma points. A late event costs a prediction and an
/// update for each event after it. No heap after construction.
template <class Filter, ProcessModelFor<typename Filter::State> Process, class... Models>
class FixedLagFilter {
 public:
  using State = typename Filter::State;
  using Square = typename Filter::Square;
  using Input = InputOf<Process>;
  using Observation = std::variant<std::monostate, Observed<Models>...>;

  /// What arrived: an observation, an input or neither.
  struct Arrival {
    Epoch epoch;
    std::optional<Input> input;
    Observation observation;
    Gate gate;
  };
  /// All that a filter is made of, for `memory` and its constructor.
  struct Memory {
    Filter filter;     ///< before the events kept
    Epoch epoch;       ///< of `filter`
    Input input;       ///< in force then
    Epoch oldest;      ///< see `oldest_epoch`
    Epoch last_input;  ///< inputs come after it
    std::vector<Arrival> arrivals;
    int capacity = 1;
  };

  /// Starts with `filter` at `start`, under `input` until the first comes. Throws std::invalid_argument when `capacity`
  /// is not positive or `start` is no valid epoch.
  FixedLagFilter(const Filter& filter, const Process& process, const Epoch& start, int capacity,
                 const Input& input = Input{})
      : process_(process),
        base_{filter, start, input},
        base_epoch_(start),
        last_input_(start),
        smoother_(checked(capacity)) {
    if (!start.is_valid()) throw std::invalid_argument("start: an invalid epoch, a valid one expected");
    // One more than is kept: the new event, before the oldest goes.
    const auto room = static_cast<std::size_t>(capacity) + 1;
    events_.reserve(room);
    order_.reserve(room);
    for (std::size_t i = 0; i < room; ++i) events_.push_back(Event(base_));
    smoothed_epochs_.reserve(room);
  }

  /// Goes on where another was, to the bit: its events are done again. Throws std::invalid_argument when there are more
  /// than the capacity, or they are not in order of their epochs.
  FixedLagFilter(const Process& process, const Memory& memory)
      : FixedLagFilter(memory.filter, process, memory.epoch, memory.capacity, memory.input) {
    if (memory.arrivals.size() > static_cast<std::size_t>(memory.capacity)) {
      throw std::invalid_argument("arrivals: " + std::to_string(memory.arrivals.size()) + ", more than the capacity");
    }
    base_epoch_ = memory.oldest;
    for (const Arrival& arrival : memory.arrivals) {
      if (!same_scale(arrival.epoch) || arrival.epoch < newest_epoch()) {
        throw std::invalid_argument("arrivals: not in order of their epochs");
      }
      static_cast<void>(insert(arrival, [](const auto&) {}));
    }
    last_input_ = memory.last_input;
  }
  /// All that the filter is made of: to be kept elsewhere. Allocates.
  [[nodiscard]] Memory memory() const {
    Memory memory{base_.filter, base_.epoch, base_.input, base_epoch_, last_input_, {}, capacity()};
    for (const int slot : order_) memory.arrivals.push_back(events_[static_cast<std::size_t>(slot)]);
    return memory;
  }

  /// Moves to `epoch` under the input in force. kTimeNotAdvancing unless it is after all events, kWrongTimeScale;
  /// else as the filter's predict.
  UpdateStatus advance(const Epoch& epoch) {
    if (!same_scale(epoch)) return UpdateStatus::kWrongTimeScale;
    if (!(epoch > newest_epoch())) return UpdateStatus::kTimeNotAdvancing;
    return insert({epoch, std::nullopt, std::monostate{}, {}}, [](const auto&) {});
  }
  /// Moves to `epoch` under the input in force, from where `input` holds. Inputs come in order among themselves
  /// (kTimeNotAdvancing otherwise) and may be late among observations (kTooLate beyond what is kept). kNonFinite, with
  /// nothing changed, for an input that is not finite.
  UpdateStatus advance(const Epoch& epoch, const Input& input) requires detail::kDriven<Process> {
    if (!same_scale(epoch)) return UpdateStatus::kWrongTimeScale;
    if (!(epoch > last_input_)) return UpdateStatus::kTimeNotAdvancing;
    if (epoch < base_epoch_) return UpdateStatus::kTooLate;
    if constexpr (requires { input.all_finite(); }) {
      if (!input.all_finite()) return UpdateStatus::kNonFinite;
    }
    const UpdateStatus status = insert({epoch, input, std::monostate{}, {}}, [](const auto&) {});
    last_input_ = epoch;
    return status;
  }

  /// Takes an observation of `epoch` in, late or not. kTooLate, with nothing changed, when it is older than what is
  /// kept; kWrongTimeScale. The report is that of the observation where it belongs, before younger ones were repeated.
  template <class Model>
  requires(std::same_as<Model, Models> || ...) UpdateReport<Model::kDim> update(const Observed<Model>& observed,
                                                                                const Epoch& epoch,
                                                                                const Gate& gate = {}) {
    using Report = UpdateReport<Model::kDim>;
    Report report;
    report.status = observed.z.allFinite() ? detail::check_noise(observed.R) : UpdateStatus::kNonFinite;
    if (!same_scale(epoch)) {
      report.status = UpdateStatus::kWrongTimeScale;
    } else if (epoch < base_epoch_) {
      report.status = UpdateStatus::kTooLate;
    }
    if (!report.accepted()) return report;
    const UpdateStatus moved = insert({epoch, std::nullopt, observed, gate}, [&report](const auto& now) {
      if constexpr (std::same_as<std::remove_cvref_t<decltype(now)>, Report>) report = now;
    });
    if (moved != UpdateStatus::kAccepted) report.status = moved;
    return report;
  }
  template <class Model>
  requires((std::same_as<Model, Models> || ...) &&
           Model::kDim == 1) UpdateReport<1> update(const Model& model, double z, double variance, const Epoch& epoch,
                                                    const Gate& gate = {}) {
    return update(Observed<Model>(model, z, variance), epoch, gate);
  }

  /// The filter after all events.
  [[nodiscard]] const Filter& filter() const noexcept { return newest().filter; }
  [[nodiscard]] decltype(auto) state() const noexcept { return filter().state(); }
  [[nodiscard]] decltype(auto) covariance() const noexcept { return filter().covariance(); }
  /// When `state()` is.
  [[nodiscard]] const Epoch& epoch() const noexcept { return newest().epoch; }
  /// Observations older than this are too late.
  [[nodiscard]] const Epoch& oldest_epoch() const noexcept { return base_epoch_; }
  /// Events kept.
  [[nodiscard]] int size() const noexcept { return static_cast<int>(order_.size()); }
  [[nodiscard]] int capacity() const noexcept { return smoother_.capacity(); }

  /// Smooths over the events kept (Rauch-Tung-Striebel): `smoothed()[i]` is the state at `smoothed_epochs()[i]` given
  /// all of them. The first is the output of a fixed-lag smoother.
  [[nodiscard]] SmoothStatus smooth() noexcept {
    smoother_.clear();
    smoothed_epochs_.clear();
    for (const int slot : order_) {
      const Event& event = events_[static_cast<std::size_t>(slot)];
      const SmoothStatus status = smoother_.record(event.record);
      if (status != SmoothStatus::kDone) {
        smoother_.clear();
        smoothed_epochs_.clear();
        return status;
      }
      smoothed_epochs_.push_back(event.after.epoch);
    }
    return smoother_.smooth();
  }
  [[nodiscard]] std::span<const SmoothedState<State>> smoothed() const noexcept { return smoother_.smoothed(); }
  [[nodiscard]] std::span<const Epoch> smoothed_epochs() const noexcept { return smoothed_epochs_; }

 private:
  struct Snapshot {
    Filter filter;
    Epoch epoch;
    Input input;
  };
  struct Event : Arrival {
    explicit Event(const Snapshot& snapshot)
        : after(snapshot),
          record{snapshot.filter.state(), snapshot.filter.covariance(), snapshot.filter.state(),
                 snapshot.filter.covariance(), snapshot.filter.covariance()} {}
    Snapshot after;
    StepRecord<State> record;
  };

  [[nodiscard]] static int checked(int capacity) {
    if (capacity < 1) {
      throw std::invalid_argument("capacity: " + std::to_string(capacity) + ", at least one expected");
    }
    return capacity;
  }
  [[nodiscard]] bool same_scale(const Epoch& epoch) const noexcept {
    return epoch.is_valid() && epoch.scale() == base_epoch_.scale();
  }
  [[nodiscard]] Event& event(std::size_t position) noexcept {
    return events_[static_cast<std::size_t>(order_[position])];
  }
  [[nodiscard]] const Snapshot& newest() const noexcept {
    return order_.empty() ? base_ : events_[static_cast<std::size_t>(order_.back())].after;
  }
  [[nodiscard]] const Epoch& newest_epoch() const noexcept {
    return order_.empty() ? base_epoch_ : events_[static_cast<std::size_t>(order_.back())].epoch;
  }

  template <class Sink>
  UpdateStatus insert(const Arrival& arrival, const Sink& sink) {
    std::size_t position = order_.size();
    while (position > 0 && arrival.epoch < event(position - 1).epoch) --position;
    const int slot = free_ >= 0 ? free_ : size();  // slots are used up in turn before any comes free
    free_ = -1;
    order_.insert(order_.begin() + static_cast<std::ptrdiff_t>(position), slot);
    static_cast<Arrival&>(event(position)) = arrival;
    UpdateStatus status = UpdateStatus::kAccepted;
    try {
      status = run(position, sink);
      rerun(position + 1);
    } catch (...) {  // of a model: as if the event had never come
      order_.erase(order_.begin() + static_cast<std::ptrdiff_t>(position));
      free_ = slot;
      rerun(position);
      throw;
    }
    if (size() > capacity()) {
      base_ = event(0).after;
      base_epoch_ = event(0).epoch;
      free_ = order_.front();
      order_.erase(order_.begin());
    }
    return status;
  }

  void rerun(std::size_t first) {
    for (std::size_t i = first; i < order_.size(); ++i) static_cast<void>(run(i, [](const auto&) {}));
  }

  // Does the event at `position` from what is before it. Returns what became of the prediction to its epoch.
  template <class Sink>
  UpdateStatus run(std::size_t position, const Sink& sink) {
    const Snapshot& before = position == 0 ? base_ : event(position - 1).after;
    Event& now = event(position);
    now.after = before;
    Filter& filter = now.after.filter;
    UpdateStatus status = UpdateStatus::kAccepted;
    now.record.cross = filter.covariance();
    const std::optional<double> dt_s = now.epoch - before.epoch;
    if (dt_s && *dt_s > 0.0) {
      Square cross;
      if constexpr (detail::kDriven<Process>) {
        status = filter.predict(process_, before.input, *dt_s, &cross);
      } else {
        status = filter.predict(process_, *dt_s, &cross);
      }
      if (status == UpdateStatus::kAccepted) {
        now.record.cross = cross;
        now.after.epoch = now.epoch;
      }
    }
    if (now.input) now.after.input = *now.input;
    now.record.predicted = filter.state();
    now.record.P_pred = filter.covariance();
    if (status == UpdateStatus::kAccepted) {
      std::visit(
          [&](const auto& observed) {
            if constexpr (!std::same_as<std::remove_cvref_t<decltype(observed)>, std::monostate>) {
              sink(filter.update(observed, now.gate));
            }
          },
          now.observation);
    }
    now.record.filtered = filter.state();
    now.record.P = filter.covariance();
    return status;
  }

  Process process_;
  Snapshot base_;
  Epoch base_epoch_;
  Epoch last_input_;
  std::vector<Event> events_;
  std::vector<int> order_;
  int free_ = -1;
  RtsSmoother<State> smoother_;
  std::vector<Epoch> smoothed_epochs_;
};

}  // namespace soopnav
