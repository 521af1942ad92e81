#include "particle_cloud_of.hpp"

namespace soopnav::python {

std::unique_ptr<ParticleCloud> make_small_cloud(CloudSettings& settings, ParticlePrior& prior) {
  return make_plain_cloud<double, 1, 2, 3, 4>(settings, prior);
}

}  // namespace soopnav::python
