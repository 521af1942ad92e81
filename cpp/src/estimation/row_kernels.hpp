#pragma once

#include <cstddef>
#include <memory>
#include <new>
#include <vector>

/// Dense matrices of a few to a few hundred rows, as whole runs of a linear filter need them.
///
/// Rows lie one behind another, each padded with zeros to a whole number of vectors of four doubles, and every
/// operation is a sum of multiples of rows. So the inner loops run along rows at full vector width for every size, and
/// each element is summed in a fixed order: the same bits for any vector width. Nothing here allocates except the
/// constructors.
namespace soopnav::detail {

/// Doubles in a row of `columns`, padding included.
[[nodiscard]] constexpr int padded(int columns) noexcept { return (columns + 3) & ~3; }

/// One zeroed block of memory from which the padded matrices of a run are cut, aligned to cache lines.
class RowArena {
 public:
  explicit RowArena(std::size_t doubles);
  /// `rows` rows of `stride` doubles (a multiple of four). The caller asks for no more than the constructor was told.
  [[nodiscard]] double* take(int rows, int stride) noexcept;

 private:
  struct Free {
    void operator()(double* p) const noexcept { ::operator delete[](p, std::align_val_t{64}); }
  };
  std::unique_ptr<double[], Free> memory_;
  std::size_t used_ = 0;
};

/// The elements of a matrix that are not zero, row by row: transition and measurement matrices are mostly zeros.
struct SparseRows {
  std::vector<int> start;  ///< of each row, and the end of the last
  std::vector<int> index;  ///< column
  std::vector<double> value;

  /// Room for every element.
  SparseRows(int rows, int columns);
  /// Takes over a packed row-major matrix of the size given to the constructor, or fewer rows.
  void assign(const double* packed, int rows, int columns) noexcept;
  /// (A x)_i.
  [[nodiscard]] double dot(int row, const double* x) const noexcept;
};

/// out = A B: `rows` rows of `stride`, from the rows of B that A picks. `from_diagonal` leaves out what lies below the
/// diagonal, to whole vectors.
void multiply(const SparseRows& A, const double* B, int rows, int stride, bool from_diagonal, double* out) noexcept;

/// out = A B for a square A of `n` padded rows.
void multiply(const double* A, const double* B, int n, int stride, double* out) noexcept;

/// out = base + Aᵀ B, or base - Aᵀ B, for A and B of `terms` rows. `from_diagonal` as above; out may be base.
void add_product(const double* base, const double* A, const double* B, int terms, int n, int stride, bool from_diagonal,
                 double* out) noexcept;
void subtract_product(const double* base, const double* A, const double* B, int terms, int n, int stride,
                      double* out) noexcept;

/// out = base + sum_t c_t * (row t of A), one row of `stride`.
void combine_rows(const double* base, const double* c, const double* A, int terms, int stride, double* out) noexcept;

/// P = Uᵀ D U with unit upper triangular U (stored with its ones) and positive D; `DU` takes their product. The upper
/// triangle of P is read. On the way B (n rows of `b_stride`) <- U⁻ᵀ B, the first half of a solution. False, at the
/// first such pivot, when one is not above `tolerance` times its diagonal element.
[[nodiscard]] bool factorize(const double* P, int n, int stride, double tolerance, double* DU, double* U, double* d,
                             double* inverse_d, double* B, int b_stride) noexcept;

/// B <- U⁻¹ D⁻¹ B, the second half.
void solve_upper(const double* U, const double* inverse_d, int n, int u_stride, double* B, int stride) noexcept;

/// out = Aᵀ of `n` padded rows.
void transpose(const double* A, int n, int stride, double* out) noexcept;

/// The upper triangle written over the lower one.
void mirror(double* A, int n, int stride) noexcept;

/// A <- (A + Aᵀ) / 2.
void symmetrize(double* A, int n, int stride) noexcept;

/// out = a - b, `count` elements (a multiple of four).
void subtract(const double* a, const double* b, int count, double* out) noexcept;

/// Whether elements that should be equal differ by no more than `tolerance` times the geometric mean of their
/// variances.
[[nodiscard]] bool is_symmetric(const double* A, int n, int stride, double tolerance) noexcept;

/// Whether all elements are finite, padding included.
[[nodiscard]] bool all_finite(const double* A, int n, int stride) noexcept;

/// Between packed rows (a NumPy array) and padded ones.
void load_rows(const double* packed, int rows, int columns, int stride, double* out) noexcept;
void store_rows(const double* A, int rows, int columns, int stride, double* packed) noexcept;

/// Asks for numbers that will be read soon: hardware does not foresee a walk backwards through an array.
void prefetch(const double* from, std::size_t count) noexcept;

}  // namespace soopnav::detail
