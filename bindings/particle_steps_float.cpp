#include "particle_move.hpp"
#include "particle_weigh.hpp"

namespace soopnav::python {

template class MoveStep<float>;
template class WeighStep<float>;

}  // namespace soopnav::python
