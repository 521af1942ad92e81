#pragma once

namespace soopnav::dsp::detail {

/// sin(pi t), exactly zero at whole numbers.
double sin_pi(double t) noexcept;

/// sin(pi t) / (pi t), 1 at t = 0 and exactly 0 at the other whole numbers.
double sinc(double t) noexcept;

/// Shape parameter of the Kaiser window whose filter has ripple 10^(-attenuation_db / 20)
/// (Kaiser 1974; doc/resampling.md eq. 3).
double kaiser_beta(double attenuation_db) noexcept;

/// Samples a filter must span for that ripple and a transition `width_rad` wide [rad per sample]
/// (doc/resampling.md eq. 4).
double kaiser_span(double attenuation_db, double width_rad) noexcept;

/// Kaiser's formula gives the ripple of one band, but what an interpolator errs by is the passband's ripple and all
/// images or aliases together: designs aim this much lower.
inline constexpr double kMarginDb = 8.0;

/// A low-pass kernel g(t) = cutoff sinc(cutoff t) w(2 t / span), zero for |t| > span / 2. `cutoff` is the middle of the
/// transition as a fraction of half the sampling rate.
class KaiserSinc {
 public:
  KaiserSinc(double cutoff, double span, double attenuation_db) noexcept;
  double operator()(double t) const noexcept;

 private:
  double cutoff_;
  double half_span_;
  double beta_;
  double scale_;
};

}  // namespace soopnav::dsp::detail
