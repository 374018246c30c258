/* plan: what is computed once for all batches of a Monte Carlo request. Internal to
 * core/montecarlo.
 */
#ifndef DIPOLED_CORE_MONTECARLO_PLAN_H
#define DIPOLED_CORE_MONTECARLO_PLAN_H

#include "core/montecarlo/montecarlo.h"
#include "core/montecarlo/walk.h"

/* Powers of the albedos by the digits of their exponent. */
enum { MC_DIGIT_BITS = 6, MC_DIGITS = 5, MC_DIGIT_VALUES = 1 << MC_DIGIT_BITS };

/* Roulette is held at some numbers of collisions only, stage after stage; stages get longer as the
 * walk does. MC_STAGES_MAX: what scatterings_max can make of them. */
enum { MC_STAGES_MAX = 768, MC_STAGE_TABLE = 4096 };

/* Chances of survival are multiples of 2^-31 (in which they are kept), so that a random number of
 * 31 bits meets them exactly and roulette is unbiased to the last bit. */
#define MC_SURVIVAL_ONE (UINT32_C(1) << 31)

/* Roulette does not depend on the path but on the number of collisions n alone, so each photon can
 * draw in advance how long it is allowed to live: to n or longer with the chance S(n). What leaves
 * after n collisions weighs albedo^n / S(n). */
typedef struct mc_stage {
  uint32_t first;    /* the collision that it begins with */
  uint32_t survival; /* S, in units of 1 / MC_SURVIVAL_ONE */
  double gain;       /* 1 / S */
} mc_stage;

/* What has become of 1 unit of power by the end of a stage's first collision, for one albedo. */
typedef struct mc_stage_energy {
  double weight;   /* albedo^first, without 1 / S */
  double absorbed; /* up to and with that collision */
  double added;    /* by roulette, including that of this stage */
} mc_stage_energy;

/* Rows of a tally; each has a number for each albedo. Two more than there are rings on each side
 * follow: the first for what is under the first edge, the last for what is over the last one. */
enum mc_row {
  MC_ROW_REFLECTED,
  MC_ROW_TRANSMITTED,
  MC_ROW_ABSORBED,
  MC_ROW_UNFINISHED,
  MC_ROW_ROULETTE, /* added less taken */
  MC_ROW_SLOTS
};
_Static_assert((int)MC_ROW_REFLECTED == (int)CORE_MC_REFLECTED &&
                   (int)MC_ROW_TRANSMITTED == (int)CORE_MC_TRANSMITTED,
               "a side is its row");

struct core_mc_plan {
  core_mc_request request; /* defaults filled in */
  walk_medium walk;
  bool walks;                   /* false: nothing is ever scattered */
  double scattered_or_absorbed; /* of the power that enters, the share that collides */
  double unscattered[CORE_MC_SIDES];
  size_t albedos;
  size_t slots; /* on each side */
  size_t stages;
  mc_stage stage[MC_STAGES_MAX];
  mc_stage_energy stage_energy[MC_STAGES_MAX][CORE_MC_ALBEDOS_MAX];
  uint16_t stage_table[MC_STAGE_TABLE]; /* of small numbers of collisions */
  double power[MC_DIGITS][MC_DIGIT_VALUES][CORE_MC_ALBEDOS_MAX];
  double weight_max[CORE_MC_ALBEDOS_MAX]; /* of any photon that leaves */
  double edges_squared_mfp2[CORE_MC_RINGS_MAX + 1];
};

static inline size_t mc_slot_row(const core_mc_plan *plan, size_t side, size_t slot) {
  return MC_ROW_SLOTS + side * plan->slots + slot;
}

static inline size_t mc_rows(const core_mc_plan *plan) {
  return mc_slot_row(plan, CORE_MC_SIDES, 0);
}

/* albedo^n for all albedos of the plan. */
static inline void mc_powers(const core_mc_plan *plan, uint32_t n, double *power) {
  const double *low = plan->power[0][n % MC_DIGIT_VALUES];
  for (size_t k = 0; k < plan->albedos; k++) {
    power[k] = low[k];
  }
  n >>= MC_DIGIT_BITS;
  for (int digit = 1; n != 0; digit++, n >>= MC_DIGIT_BITS) {
    const double *factor = plan->power[digit][n % MC_DIGIT_VALUES];
    for (size_t k = 0; k < plan->albedos; k++) {
      power[k] *= factor[k];
    }
  }
}

/* The stage that a number of collisions, at least 1, belongs to. */
size_t mc_stage_of(const core_mc_plan *plan, uint32_t collisions);

/* The collision that ends the walk of a photon with this chance (below MC_SURVIVAL_ONE):
 * roulette's at the beginning of a stage, or scatterings_max. */
uint32_t mc_last_collision(const core_mc_plan *plan, uint32_t chance);

/* The slot for light that leaves at this distance: 0 under the first edge, last over the last. */
size_t mc_slot_of(const core_mc_plan *plan, double r_squared_mfp2);

#endif
