/* montecarlo: radiative transport by random walks: the profile R(r) of the light that leaves a
 * homogeneous half space or slab, or a stack of layers, with standard errors.
 *
 * A pencil beam is launched inside, straight down. All results are per unit of power that has
 * entered the medium, which excludes the specular reflection of the beam on its way in: of each
 * unit of power that arrives, 1 - ((eta - 1) / (eta + 1))^2 enters.
 *
 *   request -> plan (immutable, shared by all threads) -> batches (one at a time for each thread)
 *           -> total (merges the batches in the order of their indices) -> results
 *
 *   plan = core_mc_plan_create(&request);
 *   total = core_mc_total_create(plan);
 *   batch = core_mc_batch_create(plan);
 *   for (index = 0; not accurate enough; index++) {
 *     core_mc_batch_start(batch, index);
 *     while (!core_mc_batch_walk(batch, isa, 200000)) {
 *       // a few ms have passed: other work can go first, or the batch be abandoned
 *     }
 *     core_mc_total_merge(total, batch);
 *   }
 *   core_mc_total_energy(total, 0, &energy);
 *
 * The same request and number of batches give the same bits on every machine and instruction set.
 * It does not matter which thread walks a batch or in what slices, for three reasons: a photon's
 * random numbers depend only on the seed and the photon's index, a batch sums its photons in a
 * fixed order, and batches are merged in order.
 *
 * One walk serves many albedos: the geometry of a path in mean free paths does not depend on the
 * albedo, and a path of n collisions weighs albedo^n. Roulette uses the largest albedo.
 *
 * No function starts a thread, waits, logs or keeps state outside of its objects. Only the
 * functions named ..._create allocate: a plan takes 0.4 MB; a batch takes 16 bytes and a total 32
 * bytes for each ring and albedo, at most 1 and 2 MB. Threads may use different objects at the same
 * time, and any number of threads may use one plan, which is only read.
 */
#ifndef DIPOLED_CORE_MONTECARLO_H
#define DIPOLED_CORE_MONTECARLO_H

#include "core/core.h"

enum {
  CORE_MC_ALBEDOS_MAX = 16,
  CORE_MC_RINGS_MAX = 4096,
  CORE_MC_BATCH_PHOTONS = 4096, /* number of photons in each batch */
};

/* limit of |g|, because directions are in single precision */
#define CORE_MC_G_MAX 0.9999
#define CORE_MC_SHARE_MIN 1e-6 /* smallest share of the first function of a mixture */
/* smallest thickness of a slab that is not empty, in mean free paths */
#define CORE_MC_THICKNESS_MIN_MFP 1e-6
/* smallest first edge of a logarithmic grid, in mean free paths */
#define CORE_MC_RADIUS_MIN_MFP 1e-8
#define CORE_MC_RADIUS_MAX_MFP 1e12
#define CORE_MC_RING_WIDTH_MIN 1e-6 /* smallest width of a ring, relative to its inner radius */
#define CORE_MC_SCATTERINGS_MAX (UINT32_C(1) << 30)
#define CORE_MC_ROULETTE_WEIGHT_MIN 1e-6

/* What to simulate. Without `below` and eta_below, this is a homogeneous medium. Otherwise it is a stack,
 * whose first layer the fields down to `albedo` describe, with one albedo and Henyey and Greenstein's
 * function. A stack's photons carry weights: the roulette weight is relative to 1, and boundaries
 * count as collisions for scatterings_max. */
typedef struct core_mc_request {
  double sigma_t_per_mm; /* sigma_a + sigma_s: CORE_SIGMA_T_PRIME_MIN_PER_MM to twice
                            CORE_SIGMA_MAX_PER_MM */
  double g;              /* mean cosine of the phase function: -CORE_MC_G_MAX to CORE_MC_G_MAX */
  double eta;            /* index inside over that above: CORE_ETA_MIN to CORE_ETA_MAX */
  /* thickness of a slab or of the first layer: 0 (a slab), or at least CORE_MC_THICKNESS_MIN_MFP mean free paths; INFINITY means a
   * half space */
  double thickness_mm;
  size_t albedo_count;                    /* number of albedos: 1 to CORE_MC_ALBEDOS_MAX */
  double albedo[CORE_MC_ALBEDOS_MAX];     /* sigma_s / sigma_t: 0 to 1 */
  size_t below_count;                     /* number of layers below the first */
  core_medium below[CORE_LAYERS_MAX - 1]; /* from the top down; INFINITY for a half space */
  /* index below a slab or a last layer of finite thickness over that above: CORE_ETA_MIN to
   * CORE_ETA_MAX, or 0 for 1 */
  double eta_below;
  /* 2 to CORE_MC_RINGS_MAX + 1 edges of rings, linear or logarithmic: ring i lies between edges i
   * and i + 1 */
  core_grid edges;
  uint64_t seed;
  /* Russian roulette ends a path, or makes it heavier, when the path weighs less than this,
   * relative to its weight at the first scattering: CORE_MC_ROULETTE_WEIGHT_MIN to 1, or 0 for the
   * default, 0.2. The value changes how long a photon takes and how much variance it brings;
   * expected results do not change. */
  double roulette_weight;
  /* A photon that has collided this many times is counted as unfinished: 2 to
   * CORE_MC_SCATTERINGS_MAX, or 0 for the default. The default is 2^20, and for g > 0 it is 2^20 /
   * (1 - g), at most CORE_MC_SCATTERINGS_MAX. Photons live so long only if there is almost no
   * absorption. */
  uint32_t scatterings_max;
  /* The phase function p of the cosine mu, HG being Henyey and Greenstein's function (1941):
   *
   *   0 or CORE_PHASE_HENYEY_GREENSTEIN   HG with the mean cosine g
   *   CORE_PHASE_MODIFIED   share HG + (1 - share) 3 mu^2 / (4 pi): Bevilacqua, Depeursinge 1999
   *   CORE_PHASE_TWO_TERM   share HG + (1 - share) HG with the mean cosine phase_g
   *
   * The mean cosine of the first HG of the last two is such that g is that of p: it is g / share,
   * or (g - (1 - share) phase_g) / share. */
  unsigned phase;
  double phase_share; /* CORE_MC_SHARE_MIN to 1; 0 for Henyey and Greenstein's function */
  double phase_g;     /* of two terms: -CORE_MC_G_MAX to CORE_MC_G_MAX; 0 for the others */
  /* Rings count the light alone that leaves at an angle to the normal outside whose sine is at most
   * this: 0 to 1, 0 for light of all angles. Energies count all light. */
  double aperture;
} core_mc_request;

/* Sets sigma_t, g, eta, one albedo, the thickness and `below` of the request from layers that
 * core_layers_check() accepts (asserted). The other fields of the request do not change. */
void core_mc_request_medium(core_mc_request *request, const core_medium *layer, size_t count);

/* Sets the phase function from the parameters phase, phase_share and phase_g, the aperture from
 * detector_na, and eta_below. Returns a fault, whose field is a parameter's name, if one is out of its range, is not
 * taken by the phase function or is missing, or if any other parameter is given. */
core_fault core_mc_request_parameters(core_mc_request *request, const core_parameters *parameters);

/* Returns the mean cosine of the first of Henyey and Greenstein's functions that the phase function
 * consists of. */
double core_mc_first_g(const core_mc_request *request);

/* Returns the first fault of the request. Its field is one of sigma_t, g, phase, phase_share,
 * phase_g, eta, thickness, albedo_count, albedo (with its index), layer_count, eta_below,
 * radius_spacing, radius_count, radius_start, radius_stop, roulette_weight, scatterings_max, aperture.
 * Those of layers have the layer's number, from 0, as their index. */
core_fault core_mc_check(const core_mc_request *request);

/* The data that all batches of a request share. */
typedef struct core_mc_plan core_mc_plan;

/* Makes a plan for a request that core_mc_check() accepts (asserted), or returns NULL if memory
 * runs out. The caller frees it with core_mc_plan_free(), after everything that was made from it.
 * All ..._free() functions of this header accept NULL. */
core_mc_plan *core_mc_plan_create(const core_mc_request *request);
void core_mc_plan_free(core_mc_plan *plan);

/* A batch: CORE_MC_BATCH_PHOTONS photons that are being walked. */
typedef struct core_mc_batch core_mc_batch;

core_mc_batch *core_mc_batch_create(const core_mc_plan *plan); /* returns NULL if memory runs out */
void core_mc_batch_free(core_mc_batch *batch);

/* Begins the batch `index`, below 2^52, and discards what the object held before. The batch walks
 * the photons from index * CORE_MC_BATCH_PHOTONS on. */
void core_mc_batch_start(core_mc_batch *batch, uint64_t index);

/* Walks the batch on for about this many scatterings. Each scattering takes some 6 ns on one core
 * with AVX-512, 11 ns with AVX2, 15 ns with SSE2, 40 ns portable. Returns true if the batch is done
 * and can be merged. */
bool core_mc_batch_walk(core_mc_batch *batch, const core_isa *isa, uint64_t scatterings);

/* A total: the merged batches of a plan. */
typedef struct core_mc_total core_mc_total;

core_mc_total *core_mc_total_create(const core_mc_plan *plan); /* returns NULL if memory runs out */
void core_mc_total_free(core_mc_total *total);

/* Merges a batch into the total. The batch has to be done, to be of the same plan, and to have the
 * index core_mc_total_batches() (all asserted). */
void core_mc_total_merge(core_mc_total *total, const core_mc_batch *batch);

/* Returns the number of batches merged so far, which is the index of the next one. */
uint64_t core_mc_total_batches(const core_mc_total *total);

/* A mean over photons and its standard error. The error is estimated from how far the n batches
 * differ, so it has a relative uncertainty of 1 / sqrt(2 (n - 1)) itself. It is INFINITY with fewer
 * than two batches. */
typedef struct core_mc_value {
  double value;
  double error;
} core_mc_value;

enum core_mc_side { CORE_MC_REFLECTED, CORE_MC_TRANSMITTED, CORE_MC_SIDES };

/* The energy balance for one albedo, as shares of the power that entered. */
typedef struct core_mc_energy {
  /* all light that left through each side, unscattered light included */
  core_mc_value left[CORE_MC_SIDES];
  core_mc_value absorbed;
  core_mc_value in_layer[CORE_LAYERS_MAX]; /* the part of `absorbed` in each layer */
  core_mc_value unfinished;                /* light still inside after scatterings_max collisions */
  /* weight that roulette has added less weight that it has taken; its expectation is 0 */
  core_mc_value roulette;
  /* The part of `left` that leaves at r = 0 without having been scattered. It is exact, and no ring
   * contains it. */
  double unscattered[CORE_MC_SIDES];
  core_mc_value under[CORE_MC_SIDES]; /* scattered light that left within the first edge */
  core_mc_value over[CORE_MC_SIDES];  /* scattered light that left beyond the last edge */
  /* left + absorbed + unfinished - roulette - 1, which is 0 up to rounding, within 1e-12; 0 before
   * any batch has been merged */
  double imbalance;
} core_mc_energy;

/* Sets *energy for the albedo at this position in the request's list (asserted to be in it). Before
 * any batch has been merged, all values except the unscattered light are 0, with infinite errors.
 */
void core_mc_total_energy(const core_mc_total *total, size_t albedo, core_mc_energy *energy);

/* The mean of R over a ring; for the side CORE_MC_TRANSMITTED, of the light that leaves there in
 * place of R. */
typedef struct core_mc_ring {
  double from_mm;
  double to_mm;
  double R_per_mm2;
  /* Standard error. Above a tenth of R it is a rough guide: few photons make up most of R, and the
   * true error is often larger. If no photon has reached a ring, R is 0 and the error is what the
   * heaviest possible photon would have added to R. */
  double error_per_mm2;
  uint64_t photons; /* number of photons that left in the ring, whatever their weight */
} core_mc_ring;

/* Fills in the caller's array of rings, which has one element less than the request has edges.
 * albedo: a position in the request's list (asserted). */
void core_mc_total_rings(const core_mc_total *total, size_t albedo, enum core_mc_side side,
                         core_mc_ring *rings);

#endif
