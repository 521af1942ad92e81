#include "particle_move.hpp"
#include "particle_weigh.hpp"

namespace soopnav::python {

template class MoveStep<double>;
template class WeighStep<double>;

}  // namespace soopnav::python
