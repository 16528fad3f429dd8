"""How dangerous traffic is: safety measures of pairs, and the conflicts of an episode."""

from sim.safety.episode_conflicts import CONFLICT_KINDS as CONFLICT_KINDS
from sim.safety.episode_conflicts import MASS_KG as MASS_KG
from sim.safety.episode_conflicts import ConflictKind as ConflictKind
from sim.safety.episode_conflicts import Conflicts as Conflicts
from sim.safety.episode_conflicts import conflicts as conflicts
from sim.safety.measures import NEAR_MISS_MPS as NEAR_MISS_MPS
from sim.safety.measures import NEAR_MISS_PET_S as NEAR_MISS_PET_S
from sim.safety.measures import NEAR_MISS_TTC_S as NEAR_MISS_TTC_S
from sim.safety.measures import Bodies as Bodies
from sim.safety.measures import PairMeasures as PairMeasures
from sim.safety.measures import is_near_miss as is_near_miss
from sim.safety.measures import pair_measures as pair_measures
