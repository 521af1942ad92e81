#include "soopnav/estimation/particle_threads.hpp"

#include <atomic>
#include <cstdint>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace soopnav::detail {

struct ParticleThreads::Crew {
  std::vector<std::thread> threads;
  // Work of the present call: written before `call_number` is raised, read after it was seen raised.
  Call call = nullptr;
  const void* body = nullptr;
  std::size_t pieces = 0;
  std::atomic<std::size_t> next{0};
  std::atomic<std::uint32_t> call_number{0};
  std::atomic<std::uint32_t> busy{0};
  std::atomic<bool> ending{false};
  std::mutex failure_lock;
  std::exception_ptr failure;

  void work() noexcept {
    try {
      for (std::size_t i = next.fetch_add(1, std::memory_order_relaxed); i < pieces;
           i = next.fetch_add(1, std::memory_order_relaxed)) {
        call(body, i);
      }
    } catch (...) {
      next.store(pieces, std::memory_order_relaxed);
      const std::lock_guard lock(failure_lock);
      if (!failure) failure = std::current_exception();
    }
  }

  // Waits until `value` is no longer `old`: awake for about the time between two parts of a step, then asleep.
  static void wait_for_change(const std::atomic<std::uint32_t>& value, std::uint32_t old) noexcept {
    constexpr int kTries = 4000;
    for (int i = 0; i < kTries; ++i) {
      if (value.load(std::memory_order_acquire) != old) return;
#if defined(__x86_64__) || defined(__i386__)
      __builtin_ia32_pause();
#endif
    }
    value.wait(old, std::memory_order_acquire);
  }

  void live() noexcept {
    std::uint32_t seen = 0;
    while (true) {
      wait_for_change(call_number, seen);
      ++seen;
      if (ending.load(std::memory_order_relaxed)) return;
      work();
      if (busy.fetch_sub(1, std::memory_order_acq_rel) == 1) busy.notify_one();
    }
  }
};

ParticleThreads::ParticleThreads(int threads) : count_(threads) {
  if (threads <= 1) return;
  crew_ = std::make_unique<Crew>();
  crew_->threads.reserve(static_cast<std::size_t>(threads - 1));
  for (int i = 1; i < threads; ++i) crew_->threads.emplace_back([crew = crew_.get()] { crew->live(); });
}

ParticleThreads::ParticleThreads(ParticleThreads&&) noexcept = default;
ParticleThreads& ParticleThreads::operator=(ParticleThreads&& other) noexcept {
  std::swap(crew_, other.crew_);
  std::swap(count_, other.count_);
  return *this;
}

ParticleThreads::~ParticleThreads() {
  if (!crew_) return;
  crew_->ending.store(true, std::memory_order_relaxed);
  crew_->call_number.fetch_add(1, std::memory_order_release);
  crew_->call_number.notify_all();
  for (std::thread& thread : crew_->threads) thread.join();
}

void ParticleThreads::run(std::size_t pieces, Call call, const void* body) {
  if (!crew_ || pieces <= 1) {
    for (std::size_t i = 0; i < pieces; ++i) call(body, i);
    return;
  }
  Crew& crew = *crew_;
  crew.call = call;
  crew.body = body;
  crew.pieces = pieces;
  crew.next.store(0, std::memory_order_relaxed);
  crew.busy.store(static_cast<std::uint32_t>(crew.threads.size()), std::memory_order_relaxed);
  crew.call_number.fetch_add(1, std::memory_order_release);
  crew.call_number.notify_all();
  crew.work();
  for (std::uint32_t left = crew.busy.load(std::memory_order_acquire); left != 0;
       left = crew.busy.load(std::memory_order_acquire)) {
    Crew::wait_for_change(crew.busy, left);
  }
  if (crew.failure) std::rethrow_exception(std::exchange(crew.failure, nullptr));
}

}  // namespace soopnav::detail
