/* montecarlo: radiative transport by random walks: the profile R(r) of the light that leaves a
 * homogeneous half space or slab, with standard errors.
 *
 * A pencil beam is launched inside, straight down: everything is per unit of power that has entered
 * the medium. The specular reflection of the beam on its way in is not part of it; of each launched
 * unit of power, 1 - ((eta - 1) / (eta + 1))^2 enters.
 *
 *   request -> plan (immutable, shared by all threads) -> batches (one at a time for each thread)
 *           -> total (batches are merged in the order of their indices) -> results
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
 * The same request and number of batches give the same bits, on every machine and instruction set,
 * whoever walks the batches in whatever slices: a photon's random numbers depend on the seed and
 * its index alone, a batch adds up its photons in an order of its own, and batches are merged in
 * order.
 *
 * One walk serves many albedos: the geometry of a path in mean free paths does not depend on them,
 * and a path of n collisions weighs albedo^n. Roulette goes by the largest albedo.
 *
 * No function starts a thread, waits, logs or keeps state elsewhere; only those named ..._create
 * allocate: a plan 0.4 MB; a batch 16 bytes, a total 32 bytes for each ring and albedo, 1 and 2 MB
 * at the most. Different objects may be used by different threads at a time; a plan is only read.
 */
#ifndef DIPOLED_CORE_MONTECARLO_H
#define DIPOLED_CORE_MONTECARLO_H

#include "core/core.h"

enum {
  CORE_MC_ALBEDOS_MAX = 16,
  CORE_MC_RINGS_MAX = 4096,
  CORE_MC_BATCH_PHOTONS = 4096, /* in each batch */
};

#define CORE_MC_G_MAX 0.9999           /* directions are in single precision */
#define CORE_MC_THICKNESS_MIN_MFP 1e-6 /* of a slab that is not empty, in mean free paths */
#define CORE_MC_RADIUS_MIN_MFP 1e-8    /* the first edge of a logarithmic grid */
#define CORE_MC_RADIUS_MAX_MFP 1e12
#define CORE_MC_RING_WIDTH_MIN 1e-6 /* of each ring, relative to its inner radius */
#define CORE_MC_SCATTERINGS_MAX (UINT32_C(1) << 30)
#define CORE_MC_ROULETTE_WEIGHT_MIN 1e-6

/* What to simulate. */
typedef struct core_mc_request {
  double sigma_t_per_mm; /* sigma_a + sigma_s: CORE_SIGMA_T_PRIME_MIN_PER_MM to twice
                            CORE_SIGMA_MAX_PER_MM */
  double g;              /* of the phase function of Henyey and Greenstein: -CORE_MC_G_MAX to
                            CORE_MC_G_MAX */
  double eta;            /* index inside over outside, the same on both sides of a slab:
                            CORE_ETA_MIN to CORE_ETA_MAX */
  double thickness_mm;   /* of a slab: 0, or at least CORE_MC_THICKNESS_MIN_MFP mean free paths;
                            INFINITY: half space */
  size_t albedo_count;   /* 1 to CORE_MC_ALBEDOS_MAX */
  double albedo[CORE_MC_ALBEDOS_MAX]; /* sigma_s / sigma_t: 0 to 1 */
  core_grid edges; /* linear or logarithmic: ring i lies between edges i and i + 1, so there is one
                      ring less than edges; 2 to CORE_MC_RINGS_MAX + 1 edges */
  uint64_t seed;
  /* A path that weighs less than this, relative to its first scattering, is ended or made heavier
   * by Russian roulette: CORE_MC_ROULETTE_WEIGHT_MIN to 1, or 0 for the default. It changes how
   * long a photon takes and how much is learned from it, not what is expected of it. */
  double roulette_weight;
  /* A photon that has collided so often is put down as unfinished: 2 to CORE_MC_SCATTERINGS_MAX,
   * or 0 for the default, 2^20, for g > 0 over 1 - g. Only next to no absorption lets any live so
   * long. */
  uint32_t scatterings_max;
} core_mc_request;

/* Sets sigma_t, g, eta and one albedo of the request from a medium, which has been checked (by
 * core_medium_check(), asserted); the rest stays. */
void core_mc_request_medium(core_mc_request *request, const core_medium *medium);

/* The first fault of the request: fields sigma_t, g, eta, thickness, albedo_count, albedo (with its
 * index), radius_spacing, radius_count, radius_start, radius_stop, roulette_weight,
 * scatterings_max. */
core_fault core_mc_check(const core_mc_request *request);

/* What all batches of a request share. */
typedef struct core_mc_plan core_mc_plan;

/* The request has been checked (asserted). NULL: out of memory. The plan must outlive what is made
 * from it. */
core_mc_plan *core_mc_plan_create(const core_mc_request *request);
void core_mc_plan_free(core_mc_plan *plan); /* NULL is allowed, here and below */

/* The request with its defaults filled in. */
const core_mc_request *core_mc_plan_request(const core_mc_plan *plan);

/* CORE_MC_BATCH_PHOTONS photons being walked. */
typedef struct core_mc_batch core_mc_batch;

core_mc_batch *core_mc_batch_create(const core_mc_plan *plan); /* NULL: out of memory */
void core_mc_batch_free(core_mc_batch *batch);

/* Begins a batch, whatever the object held before. index: below 2^52; photons index *
 * CORE_MC_BATCH_PHOTONS and on. */
void core_mc_batch_start(core_mc_batch *batch, uint64_t index);

/* Walks on, for about so many scatterings (each takes some 6 ns on one core with AVX-512, 11 ns
 * with AVX2, 15 ns with SSE2, 40 ns portable). True: the batch is done, and can be merged. */
bool core_mc_batch_walk(core_mc_batch *batch, const core_isa *isa, uint64_t scatterings);

/* What has been merged. */
typedef struct core_mc_total core_mc_total;

core_mc_total *core_mc_total_create(const core_mc_plan *plan); /* NULL: out of memory */
void core_mc_total_free(core_mc_total *total);

/* Merges a batch that is done, of the same plan, and whose index is core_mc_total_batches() (all
 * asserted). */
void core_mc_total_merge(core_mc_total *total, const core_mc_batch *batch);

/* So many batches have been merged: the index of the next one. */
uint64_t core_mc_total_batches(const core_mc_total *total);

/* A mean over photons and its standard error, estimated from how far the n batches differ, and so
 * itself known to a share of 1 / sqrt(2 (n - 1)); INFINITY with less than two batches. */
typedef struct core_mc_value {
  double value;
  double error;
} core_mc_value;

enum core_mc_side { CORE_MC_REFLECTED, CORE_MC_TRANSMITTED, CORE_MC_SIDES };

/* Where the power went, for one albedo; shares of the power that entered. */
typedef struct core_mc_energy {
  core_mc_value left[CORE_MC_SIDES]; /* through each side, unscattered light and rings and all */
  core_mc_value absorbed;
  core_mc_value unfinished; /* still inside after scatterings_max collisions */
  core_mc_value roulette;   /* what roulette has added less what it has taken; 0 is expected */
  /* Part of `left`: light that leaves at r = 0 without having been scattered, exact; it is in no
   * ring. */
  double unscattered[CORE_MC_SIDES];
  core_mc_value under[CORE_MC_SIDES]; /* scattered light that left within the first edge, */
  core_mc_value over[CORE_MC_SIDES];  /* and beyond the last */
  /* left + absorbed + unfinished - roulette - 1: 0 but for rounding, within 1e-12 */
  double imbalance;
} core_mc_energy;

/* albedo: the position in the request's list. Before any batch has been merged all but the
 * unscattered light is 0, with infinite errors. */
void core_mc_total_energy(const core_mc_total *total, size_t albedo, core_mc_energy *energy);

/* The mean of R (or its like on the other side) over a ring. */
typedef struct core_mc_ring {
  double from_mm;
  double to_mm;
  double R_per_mm2;
  /* Standard error. Above a tenth of R it is a rough guide: few photons make up most of R, and the
   * true one is often larger. A ring that no photon has reached has R = 0 and, for its error, what
   * the heaviest photon there can be would have added to it. */
  double error_per_mm2;
  uint64_t photons; /* that left there, whatever their weight */
} core_mc_ring;

/* rings: as many as the request's edges less one, of the caller. */
void core_mc_total_rings(const core_mc_total *total, size_t albedo, enum core_mc_side side,
                         core_mc_ring *rings);

#endif
