#pragma once

#include <cstddef>
#include <memory>

namespace soopnav::detail {

/// A few threads that share out numbered pieces of work; made once, asleep between calls.
///
/// Which thread does which piece is left open, so a piece must not depend on it.
class ParticleThreads {
 public:
  /// `threads` >= 1 counts the caller: one means that nothing is started.
  explicit ParticleThreads(int threads);
  ~ParticleThreads();
  /// A copy has threads of its own.
  ParticleThreads(const ParticleThreads& other) : ParticleThreads(other.count_) {}
  ParticleThreads& operator=(const ParticleThreads&) = delete;
  ParticleThreads(ParticleThreads&&) noexcept;
  ParticleThreads& operator=(ParticleThreads&&) noexcept;

  [[nodiscard]] int count() const noexcept { return count_; }

  /// Calls `body(i)` once for every i in 0 ... pieces - 1 and returns when all are done. An exception of `body` ends
  /// the work early and is passed on (the first one). One call at a time. No allocation.
  template <class Body>
  void run(std::size_t pieces, const Body& body) {
    run(
        pieces, [](const void* what, std::size_t i) { (*static_cast<const Body*>(what))(i); }, &body);
  }

 private:
  using Call = void (*)(const void* body, std::size_t piece);
  void run(std::size_t pieces, Call call, const void* body);

  struct Crew;
  std::unique_ptr<Crew> crew_;  // none for one thread
  int count_ = 1;
};

}  // namespace soopnav::detail
