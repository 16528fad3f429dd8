"""How dangerous traffic is: safety measures of pairs, and the conflicts of an episode."""

from sim.safety.measures import NEAR_MISS_MPS as NEAR_MISS_MPS
from sim.safety.measures import NEAR_MISS_PET_S as NEAR_MISS_PET_S
from sim.safety.measures import NEAR_MISS_TTC_S as NEAR_MISS_TTC_S
from sim.safety.measures import Bodies as Bodies
from sim.safety.measures import PairMeasures as PairMeasures
from sim.safety.measures import is_near_miss as is_near_miss
from sim.safety.measures import pair_measures as pair_measures
