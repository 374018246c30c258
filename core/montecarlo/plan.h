/* plan: the data that is computed once for all batches of a Monte Carlo request. Internal to
 * core/montecarlo. */
#ifndef DIPOLED_CORE_MONTECARLO_PLAN_H
#define DIPOLED_CORE_MONTECARLO_PLAN_H

#include "core/montecarlo/montecarlo.h"
#include "core/montecarlo/walk.h"

/* Powers albedo^n come from tables, one for each of the MC_DIGITS digits of n, of MC_DIGIT_BITS
 * bits each. */
enum { MC_DIGIT_BITS = 6, MC_DIGITS = 5, MC_DIGIT_VALUES = 1 << MC_DIGIT_BITS };

/* Roulette takes place only at certain numbers of collisions, where a stage begins. Stages get
 * longer as the walk does. MC_STAGES_MAX: enough stages for every scatterings_max. MC_STAGE_TABLE:
 * numbers of collisions below this find their stage in a table. */
enum { MC_STAGES_MAX = 768, MC_STAGE_TABLE = 4096 };

/* Chances of survival are kept in multiples of 2^-31, so that a random number of 31 bits meets them
 * exactly and roulette is unbiased to the last bit. */
#define MC_SURVIVAL_ONE (UINT32_C(1) << 31)

/* A stage of roulette. Roulette depends only on the number of collisions n, and not on the path, so
 * each photon draws in advance how long it may live: to n or longer with the chance S(n). Light
 * that leaves after n collisions weighs albedo^n / S(n). */
typedef struct mc_stage {
  uint32_t first;    /* number of the stage's first collision */
  uint32_t survival; /* S, in units of 1 / MC_SURVIVAL_ONE */
  double gain;       /* 1 / S */
} mc_stage;

/* The balance of 1 unit of power at the end of a stage's first collision, for one albedo. */
typedef struct mc_stage_energy {
  double weight;   /* albedo^first: the weight before it is divided by S */
  double absorbed; /* power absorbed up to and including the stage's first collision */
  double added;    /* power that roulette has added, including at the beginning of this stage */
} mc_stage_energy;

/* Rows of a tally; each row has a number for each albedo. From MC_ROW_SLOTS on there are, for each
 * side, the rows of its slots: one for the light within the first edge, one for each ring, and one
 * for the light beyond the last edge. */
enum mc_row {
  MC_ROW_REFLECTED,
  MC_ROW_TRANSMITTED,
  MC_ROW_ABSORBED,
  MC_ROW_UNFINISHED,
  MC_ROW_ROULETTE, /* power added by roulette minus power removed */
  MC_ROW_LAYERS,   /* power absorbed in each of the layers of a stack */
  MC_ROW_SLOTS = MC_ROW_LAYERS + CORE_LAYERS_MAX
};
_Static_assert((int)MC_ROW_REFLECTED == (int)CORE_MC_REFLECTED &&
                   (int)MC_ROW_TRANSMITTED == (int)CORE_MC_TRANSMITTED,
               "a side is its row");

struct core_mc_plan {
  core_mc_request request; /* the request, with defaults in place of 0 */
  walk_medium walk;
  bool walks; /* whether photons are walked: false if no light is ever scattered */
  double scattered_or_absorbed; /* share of the entered power that collides at least once */
  double unscattered[CORE_MC_SIDES];
  size_t albedos;
  size_t slots; /* number of slots on each side */
  size_t stages;
  mc_stage stage[MC_STAGES_MAX];
  mc_stage_energy stage_energy[MC_STAGES_MAX][CORE_MC_ALBEDOS_MAX];
  /* stage of each number of collisions below MC_STAGE_TABLE */
  uint16_t stage_table[MC_STAGE_TABLE];
  double power[MC_DIGITS][MC_DIGIT_VALUES][CORE_MC_ALBEDOS_MAX];
  /* largest weight that a photon can leave with, for each albedo */
  double weight_max[CORE_MC_ALBEDOS_MAX];
  double edges_squared_mfp2[CORE_MC_RINGS_MAX + 1];
};

/* Whether photons carry weights of their own, because albedos differ from layer to layer, and stop at
 * each boundary. */
static inline bool mc_is_layered(const core_mc_plan *plan) {
  return plan->walk.geometry == WALK_LAYERS;
}

static inline size_t mc_slot_row(const core_mc_plan *plan, size_t side, size_t slot) {
  return MC_ROW_SLOTS + side * plan->slots + slot;
}

static inline size_t mc_rows(const core_mc_plan *plan) {
  return mc_slot_row(plan, CORE_MC_SIDES, 0);
}

/* Sets power[k] to albedo^n for each albedo of the plan. */
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

/* Returns the stage that a number of collisions, at least 1, belongs to. */
size_t mc_stage_of(const core_mc_plan *plan, uint32_t collisions);

/* Returns the number of the collision that ends the walk of a photon with this chance, below
 * MC_SURVIVAL_ONE: the beginning of the stage at which roulette ends the walk, or scatterings_max.
 */
uint32_t mc_last_collision(const core_mc_plan *plan, uint32_t chance);

/* Returns the slot for light that leaves at this squared distance from the axis: slot 0 lies within
 * the first edge, and the last slot beyond the last edge. */
size_t mc_slot_of(const core_mc_plan *plan, double r_squared_mfp2);

#endif
