#include "core/tools/figures/walk.h"

#include <math.h>
#include <pthread.h>

#include "core/montecarlo/montecarlo.h"
#include "core/tools/tools.h"

#define SEED 20120101
#define SLICE UINT64_MAX /* walks a batch in one go: it takes milliseconds */

/* Number of batches for each thread that may be under way or wait to be merged. With more than one,
 * a slow thread does not stop the others. */
enum { BATCHES_PER_THREAD = 4, SLOTS_MAX = BATCHES_PER_THREAD * TOOLS_THREADS_MAX };

_Static_assert((int)PANEL_RATIOS <= (int)CORE_MC_ALBEDOS_MAX, "one walk serves all ratios");

typedef struct walk {
  pthread_mutex_t lock;
  pthread_cond_t merged;
  core_mc_plan *plan;
  core_mc_total *total;
  core_mc_batch *slot[SLOTS_MAX]; /* batch i is in slot i % slots */
  bool done[SLOTS_MAX];
  size_t slots;
  uint64_t next, batches;
  double batch_us;
  tools_progress *progress;
} walk;

uint64_t walk_batches(uint64_t photons) {
  const uint64_t batches = (photons + CORE_MC_BATCH_PHOTONS - 1) / CORE_MC_BATCH_PHOTONS;
  return batches < 2 ? 2 : batches;
}

/* Fits the measured times of a photon with AVX-512: 2.4 us at eta 1.3 and 5 us at eta 2. */
double walk_cost_us(double eta, uint64_t batches) {
  const double held_back = 1 / core_fresnel_moments(CORE_MOMENTS_EXACT, eta).one_minus_2c1;
  return (1 + 0.8 * held_back) * (double)(batches * CORE_MC_BATCH_PHOTONS);
}

static void merge_done(walk *w) {
  for (uint64_t index; (index = core_mc_total_batches(w->total)) < w->next;) {
    const size_t slot = index % w->slots;
    if (!w->done[slot]) {
      return;
    }
    core_mc_total_merge(w->total, w->slot[slot]);
    w->done[slot] = false;
    tools_progress_add(w->progress, w->batch_us);
    pthread_cond_broadcast(&w->merged);
  }
}

static void walk_some(void *context) {
  walk *w = context;
  const core_isa *isa = core_isa_select(NULL);
  pthread_mutex_lock(&w->lock);
  while (w->next < w->batches) {
    if (w->next - core_mc_total_batches(w->total) >= w->slots) {
      pthread_cond_wait(&w->merged, &w->lock);
      continue;
    }
    const uint64_t index = w->next++;
    const size_t slot = index % w->slots;
    pthread_mutex_unlock(&w->lock);
    core_mc_batch_start(w->slot[slot], index);
    while (!core_mc_batch_walk(w->slot[slot], isa, SLICE)) {
    }
    pthread_mutex_lock(&w->lock);
    w->done[slot] = true;
    merge_done(w);
  }
  pthread_mutex_unlock(&w->lock);
}

static void start(walk *w, panel_data *const *panels, size_t count) {
  core_mc_request request = {.thickness_mm = (double)INFINITY, .edges = panel_edges()};
  const core_medium medium = panel_medium(panels[0]);
  core_mc_request_medium(&request, &medium);
  request.seed = SEED + panels[0]->eta;
  request.albedo_count = count;
  for (size_t i = 0; i < count; i++) {
    request.albedo[i] = 1 / (1 + panel_ratio(panels[i]));
  }
  const core_fault fault = core_mc_check(&request);
  if (fault.field != NULL) {
    tools_fail("Monte Carlo refused %s: %s", fault.field, fault.allowed);
  }
  w->plan = core_mc_plan_create(&request);
  w->total = w->plan != NULL ? core_mc_total_create(w->plan) : NULL;
  bool good = w->total != NULL;
  for (size_t i = 0; good && i < w->slots; i++) {
    w->slot[i] = core_mc_batch_create(w->plan);
    good = w->slot[i] != NULL;
  }
  if (!good) {
    tools_fail("out of memory");
  }
  pthread_mutex_init(&w->lock, NULL);
  pthread_cond_init(&w->merged, NULL);
}

static void end(walk *w) {
  pthread_cond_destroy(&w->merged);
  pthread_mutex_destroy(&w->lock);
  for (size_t i = 0; i < w->slots; i++) {
    core_mc_batch_free(w->slot[i]);
  }
  core_mc_total_free(w->total);
  core_mc_plan_free(w->plan);
}

static void fill(panel_data *panel, const core_mc_total *total, size_t albedo) {
  core_mc_ring rings[PANEL_RINGS];
  core_mc_energy energy;
  core_mc_total_rings(total, albedo, CORE_MC_REFLECTED, rings);
  core_mc_total_energy(total, albedo, &energy);
  for (size_t i = 0; i < PANEL_RINGS; i++) {
    panel->value[COLUMN_MONTE_CARLO][i] = rings[i].R_per_mm2;
    panel->value[COLUMN_MONTE_CARLO_ERROR][i] = rings[i].error_per_mm2;
  }
  panel->albedo[COLUMN_MONTE_CARLO] = energy.left[CORE_MC_REFLECTED].value;
  panel->albedo[COLUMN_MONTE_CARLO_ERROR] = energy.left[CORE_MC_REFLECTED].error;
  panel->known[PANEL_WALK] = true;
}

void walk_run(panel_data *const *panels, size_t count, uint64_t batches, size_t threads,
              tools_progress *progress) {
  walk w = {.slots = BATCHES_PER_THREAD * threads,
            .batches = batches,
            .batch_us = walk_cost_us(panel_eta(panels[0]), 1),
            .progress = progress};
  start(&w, panels, count);
  tools_in_threads(threads, walk_some, &w);
  for (size_t i = 0; i < count; i++) {
    fill(panels[i], w.total, i);
  }
  end(&w);
}
