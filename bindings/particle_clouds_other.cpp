#include "particle_cloud_of.hpp"

namespace soopnav::python {

std::unique_ptr<ParticleCloud> make_single_cloud(CloudSettings& settings, ParticlePrior& prior) {
  return make_plain_cloud<float, 2, 5>(settings, prior);
}

std::unique_ptr<ParticleCloud> make_heading_cloud(CloudSettings& settings, ParticlePrior& prior) {
  if (settings.state == kStateName<Pose2>) {
    return std::make_unique<CloudOf<Pose2, double>>(std::move(settings), std::move(prior));
  }
  return std::make_unique<CloudOf<PlanarInertialState, double>>(std::move(settings), std::move(prior));
}

}  // namespace soopnav::python
