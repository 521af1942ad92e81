#include "particle_cloud_of.hpp"

namespace soopnav::python {

std::unique_ptr<ParticleCloud> make_large_cloud(CloudSettings& settings, ParticlePrior& prior) {
  return make_plain_cloud<double, 5, 6, 7, 8>(settings, prior);
}

}  // namespace soopnav::python
