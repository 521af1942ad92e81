#include "estimation/row_kernels.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

// Compiled for the baseline, for AVX2 and for AVX-512, and chosen between at run time. By hand: what target_clones
// copies has its vectors taken apart for the baseline already. The wider sets change no bit, as every element is summed
// by itself and -ffp-contract=off keeps AVX-512's fused multiply-adds out.
#ifndef SOOPNAV_ROW_SETS  // 0: the baseline alone, 1: AVX2 as well, 2: AVX-512 as well
#if !defined(SOOPNAV_NO_TARGET_CLONES) && defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define SOOPNAV_ROW_SETS 2
#else
#define SOOPNAV_ROW_SETS 0
#endif
#endif

namespace soopnav::detail {

namespace {

#define SOOPNAV_ROW_INLINE inline __attribute__((always_inline))

// Rows are cut into vectors of `Width` doubles, wherever they lie.
template <int Width>
struct Lanes {
  typedef double Type  // NOLINT(modernize-use-using): the attribute needs it
      __attribute__((vector_size(static_cast<unsigned long>(Width) * sizeof(double)), aligned(8), may_alias));
};
template <int Width>
using Vector = typename Lanes<Width>::Type;
constexpr int kQuad = 4;    // rows are whole multiples of this
constexpr int kPanel = 16;  // columns summed at once: with the operands they fit the registers of every set

template <int Width>
SOOPNAV_ROW_INLINE const Vector<Width>* vectors(const double* p) {
  return reinterpret_cast<const Vector<Width>*>(p);
}
template <int Width>
SOOPNAV_ROW_INLINE Vector<Width>* vectors(double* p) {
  return reinterpret_cast<Vector<Width>*>(p);
}

enum class Sign { kPlus, kMinus };

// Columns of one row, kept in registers while multiples of other rows are added.
template <int Width, int Columns>
struct Panel {
  static constexpr int kWhole = Columns / Width;
  static constexpr int kRest = Columns % Width;  // a quad, where a vector is longer than that
  static_assert(kRest == 0 || kRest == kQuad);
  Vector<Width> whole[static_cast<std::size_t>(std::max(kWhole, 1))];
  Vector<kQuad> rest;

  SOOPNAV_ROW_INLINE void load(const double* from) {
    for (int v = 0; v < kWhole; ++v) whole[v] = vectors<Width>(from)[v];
    if constexpr (kRest != 0) rest = *vectors<kQuad>(from + kWhole * Width);
  }
  SOOPNAV_ROW_INLINE void clear() {
    for (int v = 0; v < kWhole; ++v) whole[v] = Vector<Width>{};
    rest = Vector<kQuad>{};
  }
  template <Sign sign>
  SOOPNAV_ROW_INLINE void add(double c, const double* row) {
    for (int v = 0; v < kWhole; ++v) {
      if constexpr (sign == Sign::kPlus) {
        whole[v] += c * vectors<Width>(row)[v];
      } else {
        whole[v] -= c * vectors<Width>(row)[v];
      }
    }
    if constexpr (kRest != 0) {
      if constexpr (sign == Sign::kPlus) {
        rest += c * *vectors<kQuad>(row + kWhole * Width);
      } else {
        rest -= c * *vectors<kQuad>(row + kWhole * Width);
      }
    }
  }
  SOOPNAV_ROW_INLINE void scale(double c) {
    for (int v = 0; v < kWhole; ++v) whole[v] *= c;
    if constexpr (kRest != 0) rest *= c;
  }
  SOOPNAV_ROW_INLINE void store(double* to) const {
    for (int v = 0; v < kWhole; ++v) vectors<Width>(to)[v] = whole[v];
    if constexpr (kRest != 0) *vectors<kQuad>(to + kWhole * Width) = rest;
  }
};

// out = scale * base +- sum_t term.coefficient(t) * term.row(t), t ascending, over some columns of a row. Without a
// base the sum starts at zero.
template <int Width, int Columns, Sign sign, class Terms>
SOOPNAV_ROW_INLINE void sum_panel(const double* base, double scale, const Terms& terms, int offset, double* out) {
  Panel<Width, Columns> sum;
  if (base == nullptr) {
    sum.clear();
  } else {
    sum.load(base + offset);
    if constexpr (Terms::kScaled) sum.scale(scale);
  }
  for (int t = 0; t < terms.count; ++t) sum.template add<sign>(terms.coefficient(t), terms.row(t) + offset);
  sum.store(out + offset);
}

// The same from column `first` (a multiple of four) to the end of the row.
template <int Width, Sign sign, class Terms>
SOOPNAV_ROW_INLINE void sum_rows(const double* base, double scale, const Terms& terms, int first, int stride,
                                 double* out) {
  for (; stride - first >= kPanel; first += kPanel) sum_panel<Width, kPanel, sign>(base, scale, terms, first, out);
  switch (stride - first) {
    case 12:
      sum_panel<Width, 12, sign>(base, scale, terms, first, out);
      break;
    case 8:
      sum_panel<Width, 8, sign>(base, scale, terms, first, out);
      break;
    case 4:
      sum_panel<Width, 4, sign>(base, scale, terms, first, out);
      break;
    default:
      break;
  }
}

// Coefficients at equal distances (a row or a column of a matrix), rows one behind another, upwards or downwards.
struct Strided {
  static constexpr bool kScaled = false;
  int count;
  const double* c;
  int c_step;
  const double* rows;
  int row_step;
  SOOPNAV_ROW_INLINE double coefficient(int t) const { return c[t * c_step]; }
  SOOPNAV_ROW_INLINE const double* row(int t) const { return rows + t * row_step; }
};
struct ScaledStrided : Strided {
  static constexpr bool kScaled = true;
};

// The elements of a sparse row.
struct Picked {
  static constexpr bool kScaled = false;
  int count;
  const double* c;
  const int* index;
  const double* rows;
  int row_step;
  SOOPNAV_ROW_INLINE double coefficient(int t) const { return c[t]; }
  SOOPNAV_ROW_INLINE const double* row(int t) const { return rows + index[t] * row_step; }
};

// First column of the vector, of a quad at least, that holds column `i`.
template <int Width>
SOOPNAV_ROW_INLINE int vector_of(int i) {
  return i & ~(std::max(Width, kQuad) - 1);
}

struct MultiplySparse {
  template <int Width>
  SOOPNAV_ROW_INLINE static void run(const SparseRows* A, const double* B, int rows, int stride, bool from_diagonal,
                                     double* out) {
    const int* const start = A->start.data();
    for (int i = 0; i < rows; ++i) {
      const Picked terms{start[i + 1] - start[i], A->value.data() + start[i], A->index.data() + start[i], B, stride};
      sum_rows<Width, Sign::kPlus>(nullptr, 1.0, terms, from_diagonal ? vector_of<Width>(i) : 0, stride,
                                   out + i * stride);
    }
  }
};

struct MultiplyDense {
  template <int Width>
  SOOPNAV_ROW_INLINE static void run(const double* A, const double* B, int n, int stride, double* out) {
    for (int i = 0; i < n; ++i) {
      sum_rows<Width, Sign::kPlus>(nullptr, 1.0, Strided{n, A + i * stride, 1, B, stride}, 0, stride, out + i * stride);
    }
  }
};

template <Sign sign>
struct Combine {
  template <int Width>
  SOOPNAV_ROW_INLINE static void run(const double* base, const double* A, const double* B, int terms, int n, int stride,
                                     bool from_diagonal, double* out) {
    for (int i = 0; i < n; ++i) {
      sum_rows<Width, sign>(base + i * stride, 1.0, Strided{terms, A + i, stride, B, stride},
                            from_diagonal ? vector_of<Width>(i) : 0, stride, out + i * stride);
    }
  }
};

struct CombineRows {
  template <int Width>
  SOOPNAV_ROW_INLINE static void run(const double* base, const double* c, const double* A, int terms, int stride,
                                     double* out) {
    sum_rows<Width, Sign::kPlus>(base, 1.0, Strided{terms, c, 1, A, stride}, 0, stride, out);
  }
};

struct Factorize {
  template <int Width>
  SOOPNAV_ROW_INLINE static bool run(const double* P, int n, int stride, double tolerance, double* DU, double* U,
                                     double* d, double* inverse_d, double* B, int b_stride) {
    for (int k = 0; k < n; ++k) {
      double* const row = DU + k * stride;
      const int first = vector_of<Width>(k);
      sum_rows<Width, Sign::kMinus>(P + k * stride, 1.0, Strided{k, U + k, stride, DU, stride}, first, stride, row);
      const double pivot = row[k];
      if (!(pivot > tolerance * P[k * stride + k]) || !(pivot > 0.0)) return false;
      d[k] = pivot;
      inverse_d[k] = 1.0 / pivot;
      double* const u = U + k * stride;
      for (int j = first; j < stride; j += kQuad) *vectors<kQuad>(u + j) = inverse_d[k] * *vectors<kQuad>(row + j);
      // Here, and not afterwards: it does not wait for the division.
      double* const b = B + k * b_stride;
      sum_rows<Width, Sign::kMinus>(b, 1.0, Strided{k, U + k, stride, B, b_stride}, 0, b_stride, b);
    }
    return true;
  }
};

struct SolveUpper {
  template <int Width>
  SOOPNAV_ROW_INLINE static void run(const double* U, const double* inverse_d, int n, int u_stride, double* B,
                                     int stride) {
    for (int k = n - 1; k >= 0; --k) {
      double* const row = B + k * stride;
      // From the last row upwards, so that the row just solved is needed last.
      const ScaledStrided terms{{n - 1 - k, U + k * u_stride + n - 1, -1, B + (n - 1) * stride, -stride}};
      sum_rows<Width, Sign::kMinus>(row, inverse_d[k], terms, 0, stride, row);
    }
  }
};

struct Subtract {
  template <int Width>
  SOOPNAV_ROW_INLINE static void run(const double* a, const double* b, int count, double* out) {
    for (int i = 0; i < count; i += kQuad) {
      *vectors<kQuad>(out + i) = *vectors<kQuad>(a + i) - *vectors<kQuad>(b + i);
    }
  }
};

struct AllFinite {
  template <int Width>
  SOOPNAV_ROW_INLINE static bool run(const double* A, int size) {
    // 0 * inf and 0 * NaN are NaN. Four sums hide the latency of an addition.
    Vector<kQuad> s0{}, s1{}, s2{}, s3{};
    int i = 0;
    for (; i + 4 * kQuad <= size; i += 4 * kQuad) {
      s0 += 0.0 * *vectors<kQuad>(A + i);
      s1 += 0.0 * *vectors<kQuad>(A + i + kQuad);
      s2 += 0.0 * *vectors<kQuad>(A + i + 2 * kQuad);
      s3 += 0.0 * *vectors<kQuad>(A + i + 3 * kQuad);
    }
    for (; i < size; i += kQuad) s0 += 0.0 * *vectors<kQuad>(A + i);
    const Vector<kQuad> sum = (s0 + s1) + (s2 + s3);
    return (sum[0] + sum[1]) + (sum[2] + sum[3]) == 0.0;
  }
};

// Between rows at different distances. A call of memcpy for every short row would cost more than the copy.
struct CopyRows {
  template <int Width>
  SOOPNAV_ROW_INLINE static void run(const double* from, int from_step, double* to, int to_step, int rows,
                                     int columns) {
    for (int i = 0; i < rows; ++i, from += from_step, to += to_step) {
      int j = 0;
      for (; j + kQuad <= columns; j += kQuad) *vectors<kQuad>(to + j) = *vectors<kQuad>(from + j);
      for (; j < columns; ++j) to[j] = from[j];
    }
  }
};

#if SOOPNAV_ROW_SETS >= 2
template <class Kernel, class... Args>
__attribute__((target("avx512f"))) auto run_avx512(Args... args) {
  return Kernel::template run<8>(args...);
}
#endif
#if SOOPNAV_ROW_SETS >= 1
template <class Kernel, class... Args>
__attribute__((target("avx2"))) auto run_avx2(Args... args) {
  return Kernel::template run<4>(args...);
}
#endif
template <class Kernel, class... Args>
auto run_baseline(Args... args) {
  return Kernel::template run<2>(args...);
}

template <class Kernel, class... Args>
SOOPNAV_ROW_INLINE auto run(Args... args) {
#if SOOPNAV_ROW_SETS >= 2
  if (__builtin_cpu_supports("avx512f")) return run_avx512<Kernel>(args...);
#endif
#if SOOPNAV_ROW_SETS >= 1
  if (__builtin_cpu_supports("avx2")) return run_avx2<Kernel>(args...);
#endif
  return run_baseline<Kernel>(args...);
}

}  // namespace

RowArena::RowArena(std::size_t doubles)
    : memory_(static_cast<double*>(::operator new[](doubles * sizeof(double), std::align_val_t{64}))) {
  std::fill_n(memory_.get(), doubles, 0.0);
}

double* RowArena::take(int rows, int stride) noexcept {
  double* const p = memory_.get() + used_;
  used_ += static_cast<std::size_t>(rows) * static_cast<std::size_t>(stride);
  return p;
}

SparseRows::SparseRows(int rows, int columns)
    : start(static_cast<std::size_t>(rows) + 1),
      index(static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns)),
      value(index.size()) {}

void SparseRows::assign(const double* packed, int rows, int columns) noexcept {
  int count = 0;
  int* const s = start.data();
  for (int i = 0; i < rows; ++i) {
    s[i] = count;
    for (int j = 0; j < columns; ++j) {
      const double a = packed[i * columns + j];
      if (a == 0.0) continue;
      index[static_cast<std::size_t>(count)] = j;
      value[static_cast<std::size_t>(count)] = a;
      ++count;
    }
  }
  s[rows] = count;
}

double SparseRows::dot(int row, const double* x) const noexcept {
  const int* const s = start.data();
  double sum = 0.0;
  for (int t = s[row]; t < s[row + 1]; ++t) sum += value.data()[t] * x[index.data()[t]];
  return sum;
}

void multiply(const SparseRows& A, const double* B, int rows, int stride, bool from_diagonal, double* out) noexcept {
  run<MultiplySparse>(&A, B, rows, stride, from_diagonal, out);
}

void multiply(const double* A, const double* B, int n, int stride, double* out) noexcept {
  run<MultiplyDense>(A, B, n, stride, out);
}

void add_product(const double* base, const double* A, const double* B, int terms, int n, int stride, bool from_diagonal,
                 double* out) noexcept {
  run<Combine<Sign::kPlus>>(base, A, B, terms, n, stride, from_diagonal, out);
}

void subtract_product(const double* base, const double* A, const double* B, int terms, int n, int stride,
                      double* out) noexcept {
  run<Combine<Sign::kMinus>>(base, A, B, terms, n, stride, false, out);
}

void combine_rows(const double* base, const double* c, const double* A, int terms, int stride, double* out) noexcept {
  run<CombineRows>(base, c, A, terms, stride, out);
}

bool factorize(const double* P, int n, int stride, double tolerance, double* DU, double* U, double* d,
               double* inverse_d, double* B, int b_stride) noexcept {
  return run<Factorize>(P, n, stride, tolerance, DU, U, d, inverse_d, B, b_stride);
}

void solve_upper(const double* U, const double* inverse_d, int n, int u_stride, double* B, int stride) noexcept {
  run<SolveUpper>(U, inverse_d, n, u_stride, B, stride);
}

void transpose(const double* A, int n, int stride, double* out) noexcept {
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) out[i * stride + j] = A[j * stride + i];
  }
}

void mirror(double* A, int n, int stride) noexcept {
  for (int i = 1; i < n; ++i) {
    for (int j = 0; j < i; ++j) A[i * stride + j] = A[j * stride + i];
  }
}

void symmetrize(double* A, int n, int stride) noexcept {
  for (int i = 1; i < n; ++i) {
    for (int j = 0; j < i; ++j) {
      const double mean = 0.5 * (A[i * stride + j] + A[j * stride + i]);
      A[i * stride + j] = mean;
      A[j * stride + i] = mean;
    }
  }
}

void subtract(const double* a, const double* b, int count, double* out) noexcept { run<Subtract>(a, b, count, out); }

bool is_symmetric(const double* A, int n, int stride, double tolerance) noexcept {
  // Equal to the bit as a rule, which is soon seen.
  std::uint64_t unequal = 0;
  for (int i = 1; i < n; ++i) {
    for (int j = 0; j < i; ++j) {
      unequal |= std::bit_cast<std::uint64_t>(A[i * stride + j]) ^ std::bit_cast<std::uint64_t>(A[j * stride + i]);
    }
  }
  if (unequal == 0) return true;
  for (int i = 1; i < n; ++i) {
    for (int j = 0; j < i; ++j) {
      const double difference = std::abs(A[i * stride + j] - A[j * stride + i]);
      if (!(difference <= tolerance * std::sqrt(std::abs(A[i * stride + i] * A[j * stride + j])))) return false;
    }
  }
  return true;
}

bool all_finite(const double* A, int n, int stride) noexcept { return run<AllFinite>(A, n * stride); }

void load_rows(const double* packed, int rows, int columns, int stride, double* out) noexcept {
  run<CopyRows>(packed, columns, out, stride, rows, columns);
}

void store_rows(const double* A, int rows, int columns, int stride, double* packed) noexcept {
  run<CopyRows>(A, stride, packed, columns, rows, columns);
}

void prefetch(const double* from, std::size_t count) noexcept {
  constexpr std::size_t kLine = 8;
  for (std::size_t i = 0; i < count; i += kLine) __builtin_prefetch(from + i, 0, 2);
}

}  // namespace soopnav::detail
