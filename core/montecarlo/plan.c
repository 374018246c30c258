/* Plans: the unscattered light, the schedule of roulette, and tables for scoring. */
#include "core/montecarlo/plan.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

#define CORE_REAL 64
#include "core/kernel.h"

/* ---- the unscattered light ------------------------------------------------------------------- */

/* A thicker layer is taken as a half space: no photon of single precision comes so deep. */
#define THICKNESS_MAX_MFP 1e30

/* A layer for the unscattered light. */
struct passage {
  double eta;       /* index over that above all layers */
  double left;      /* share of light that crosses the layer without a collision */
  double gone;      /* 1 - left */
  double reflected; /* share of light at the foot, going down, that comes back there */
};

static double reflectance(double inside, double outside) {
  const double amplitude = (inside - outside) / (inside + outside);
  return amplitude * amplitude;
}

/* Computes the unscattered light and the distribution of the first collision. Straight down and up,
 * light is weakened by `left` on each passage of a layer and reflected with F at each boundary, any
 * number of times. With B_i the share that comes back at the foot of layer i, and Q_i = F_i
 * B_(i+1) left_(i+1)^2, F_i between layers i and i + 1,
 *
 *   B_i = F_i + (1 - F_i)^2 B_(i+1) left_(i+1)^2 / (1 - Q_i)
 *   light down at the head of i + 1 = (1 - F_i) light down at the foot of i / (1 - Q_i)
 *
 * These are exact; the walk begins at the first collision. In a half space all light collides. */
static void prepare_first_flight(core_mc_plan *plan, struct passage *in, size_t count,
                                 double eta_below) {
  double collides[2 * CORE_LAYERS_MAX];
  double again = 0; /* share of light down at the head of the layer below that comes back there */
  for (size_t i = count; i-- > 0;) {
    const double F = reflectance(in[i].eta, i + 1 < count ? in[i + 1].eta : eta_below);
    in[i].reflected = F + (1 - F) * (1 - F) * again / (1 - F * again);
    again = in[i].reflected * in[i].left * in[i].left;
  }
  double above = reflectance(in[0].eta, 1);
  double down = 1 / (1 - above * again);
  plan->unscattered[CORE_MC_REFLECTED] = (1 - above) * again * down;
  plan->scattered_or_absorbed = 0;
  for (size_t i = 0; i < count; i++) {
    const double foot = down * in[i].left;
    collides[2 * i] = foot * in[i].reflected * in[i].gone;
    collides[2 * i + 1] = down * in[i].gone;
    plan->scattered_or_absorbed += collides[2 * i] + collides[2 * i + 1];
    above = reflectance(in[i].eta, i + 1 < count ? in[i + 1].eta : eta_below);
    again = i + 1 < count ? in[i + 1].reflected * in[i + 1].left * in[i + 1].left : 0;
    down = (1 - above) * foot / (1 - above * again);
    plan->walk.first_share[i] = (float)in[i].gone;
    plan->walk.first_rest[i] = (float)in[i].left;
  }
  plan->unscattered[CORE_MC_TRANSMITTED] = down;
  double sum = 0;
  for (size_t j = 0; j + 1 < 2 * count; j++) {
    sum += collides[j];
    plan->walk.first_sum[j] = (float)(sum / plan->scattered_or_absorbed);
  }
}

static walk_hg hg_of(double g) {
  return (walk_hg){
      .sign = g < 0 ? -1.0f : 1.0f,
      .size = (float)fabs(g),
      .one_minus = (float)(1 - fabs(g)),
      .one_plus = (float)(1 + fabs(g)),
  };
}

static void set_hg(walk_medium *walk, size_t layer, double g) {
  const walk_hg hg = hg_of(g);
  walk->g_sign[layer] = hg.sign;
  walk->g_size[layer] = hg.size;
  walk->g_one_minus[layer] = hg.one_minus;
  walk->g_one_plus[layer] = hg.one_plus;
}

/* Snell's law gives ct^2 = 1 - eta^2 (1 - ci^2). With the squared cosine ci^2, light near the
 * normal loses digits if eta is large; with the squared sine 1 - ci^2, grazing light loses digits
 * if eta is near 1. */
static void set_face(walk_medium *walk, size_t face, double eta) {
  const bool by_sine = eta > 1.2;
  walk->eta[face] = (float)eta;
  walk->by_sine[face] = by_sine ? ~UINT32_C(0) : 0;
  walk->cosine_constant[face] = (float)(by_sine ? 1 : 1 - eta * eta);
  walk->cosine_factor[face] = (float)(by_sine ? -eta * eta : eta * eta);
}

static enum walk_phase walk_phase_of(const core_mc_request *request) {
  return request->phase == CORE_PHASE_MODIFIED   ? WALK_MODIFIED
         : request->phase == CORE_PHASE_TWO_TERM ? WALK_TWO_TERM
         : request->g == 0                       ? WALK_ISOTROPIC
                                                 : WALK_HENYEY_GREENSTEIN;
}

static void prepare_phase(walk_medium *walk, const core_mc_request *request) {
  const uint32_t share = (uint32_t)(request->phase_share * WALK_POINTS);
  walk->phase = walk_phase_of(request);
  walk->second = hg_of(request->phase_g);
  walk->share = share;
  walk->share_inverse = (float)(1 / fmax(share, 1));
  walk->rest_inverse = (float)(share < WALK_POINTS ? 1.0 / (WALK_POINTS - share) : 0);
}

/* Lengths are in mean free paths of the top layer. */
static void prepare_walk(core_mc_plan *plan) {
  const core_mc_request *request = &plan->request;
  walk_medium *walk = &plan->walk;
  const size_t count = request->below_count + 1;
  const double eta_below = request->eta_below;
  double above = 1; /* index */
  struct passage in[CORE_LAYERS_MAX];
  *walk = (walk_medium){
      .key = {(uint32_t)request->seed, (uint32_t)(request->seed >> 32)},
      .last = (uint32_t)request->below_count,
  };
  for (size_t i = 0; i < count; i++) {
    const core_medium *below = &request->below[i > 0 ? i - 1 : 0];
    const double sigma_t =
        i > 0 ? below->sigma_a_per_mm + below->sigma_s_per_mm : request->sigma_t_per_mm;
    const double tau = sigma_t * (i > 0 ? below->thickness_mm : request->thickness_mm);
    const double mfp = request->sigma_t_per_mm / sigma_t;
    const bool finite = tau < THICKNESS_MAX_MFP;
    const real_exp_values decay = real_exp(finite ? -tau : 0);
    const double eta = i > 0 ? below->eta : request->eta;
    const double beyond = i + 1 < count ? request->below[i].eta : eta_below;
    in[i] = (struct passage){eta, finite ? decay.exp : 0, finite ? decay.one_minus_exp : 1, 0};
    set_hg(walk, i, i > 0 ? below->g : core_mc_first_g(request));
    set_face(walk, 2 * i, eta / above);
    set_face(walk, 2 * i + 1, eta / beyond);
    walk->mfp[i] = (float)mfp;
    walk->thickness[i] = finite ? (float)(tau * mfp) : INFINITY;
    walk->albedo[i] = (float)(i > 0 ? below->sigma_s_per_mm / sigma_t : request->albedo[0]);
    above = eta;
  }
  walk->geometry = request->below_count > 0 || eta_below != 1 ? WALK_LAYERS
                   : walk->thickness[0] < INFINITY            ? WALK_SLAB
                                                              : WALK_HALF_SPACE;
  prepare_phase(walk, request);
  prepare_first_flight(plan, in, count, eta_below);
}

/* ---- roulette -------------------------------------------------------------------------------- */

#define ROULETTE_WEIGHT_DEFAULT 0.2
#define SCATTERINGS_MAX_DEFAULT 1048576.0
/* smallest chance of survival: the few photons that come so far are not reduced further */
#define SURVIVAL_MIN 0x1p-20

/* A path of more than LONG_PATH collisions (over 1 - g for g > 0) counts as long, even without
 * absorption. */
#define LONG_PATH 1024.0

static double forward_scatterings(const core_mc_request *request) {
  double g = real_max(request->g, 0);
  for (size_t i = 0; i < request->below_count; i++) {
    g = real_max(g, request->below[i].g);
  }
  return 1 / (1 - g);
}

static void fill_in_defaults(core_mc_request *request) {
  if (request->roulette_weight == 0) {
    request->roulette_weight = ROULETTE_WEIGHT_DEFAULT;
  }
  if (request->scatterings_max == 0) {
    const double scatterings = SCATTERINGS_MAX_DEFAULT * forward_scatterings(request);
    request->scatterings_max = (uint32_t)real_min(scatterings, (double)CORE_MC_SCATTERINGS_MAX);
  }
  if (request->eta_below == 0) {
    request->eta_below = 1;
  }
}

/* Returns the chance S that a path of n collisions survives, where `weight` is albedo^n. Once a
 * path's weight has fallen to the roulette weight, S keeps it there. Without absorption, paths in a
 * half space come back to the boundary with a probability of 1, but after n collisions a share of 1
 * / sqrt(n) is still on its way, so their mean length is infinite. With S proportional to 1 /
 * sqrt(n), each octave of n costs the same and brings the same variance. */
static double wanted_survival(const core_mc_request *request, double weight, double n) {
  const double by_weight = weight / request->roulette_weight;
  const double by_length = sqrt(LONG_PATH * forward_scatterings(request) / n);
  return real_max(real_min(by_weight, 1) * real_min(by_length, 1), SURVIVAL_MIN);
}

static double largest_albedo(const core_mc_plan *plan, const double *values) {
  size_t largest = 0;
  for (size_t k = 1; k < plan->albedos; k++) {
    largest = plan->request.albedo[k] > plan->request.albedo[largest] ? k : largest;
  }
  return values[largest];
}

/* Returns where the stage after `first` begins: at the next collision up to 64, later after 1/32 of
 * the path so far. */
static uint32_t next_stage(uint32_t first) {
  return first + (first < 64 ? 1 : first / 32);
}

/* Roulette in layers, where weights depend on the way: it takes place at each collision. */
static void prepare_layered_roulette(core_mc_plan *plan) {
  const core_mc_request *request = &plan->request;
  const double long_path = LONG_PATH * forward_scatterings(request);
  const double longest = sqrt(request->scatterings_max / long_path);
  plan->walk.roulette_weight = (float)request->roulette_weight;
  plan->walk.long_path_inverse = (float)(1 / long_path);
  plan->weight_max[0] = real_max(1, request->roulette_weight * longest);
}

static void prepare_stages(core_mc_plan *plan) {
  double power[CORE_MC_ALBEDOS_MAX];
  plan->stage[0] = (mc_stage){1, MC_SURVIVAL_ONE, 1};
  plan->stages = 1;
  for (uint32_t n = 2; n < plan->request.scatterings_max; n = next_stage(n)) {
    assert(plan->stages < MC_STAGES_MAX);
    mc_powers(plan, n - 1, power);
    const double S = wanted_survival(&plan->request, largest_albedo(plan, power), n);
    const uint32_t survival = (uint32_t)(S * MC_SURVIVAL_ONE);
    plan->stage[plan->stages++] = (mc_stage){n, survival, (double)MC_SURVIVAL_ONE / survival};
  }
}

static void prepare_stage_energies(core_mc_plan *plan, size_t k) {
  const double albedo = plan->request.albedo[k];
  mc_stage_energy now = {.weight = albedo, .absorbed = 1 - albedo, .added = 0};
  double weight_max = now.weight;
  plan->stage_energy[0][k] = now;
  for (size_t j = 1; j < plan->stages; j++) {
    double power[CORE_MC_ALBEDOS_MAX];
    mc_powers(plan, plan->stage[j].first, power);
    const double gain_before = plan->stage[j - 1].gain;
    now.absorbed += gain_before * (now.weight - power[k]);
    now.weight = power[k];
    now.added += now.weight * (plan->stage[j].gain - gain_before);
    weight_max = real_max(weight_max, now.weight * plan->stage[j].gain);
    plan->stage_energy[j][k] = now;
  }
  plan->weight_max[k] = weight_max;
}

/* ---- tables ---------------------------------------------------------------------------------- */

static void prepare_powers(core_mc_plan *plan, size_t k) {
  double base = plan->request.albedo[k];
  for (int digit = 0; digit < MC_DIGITS; digit++) {
    double power = 1;
    for (int value = 0; value < MC_DIGIT_VALUES; value++) {
      plan->power[digit][value][k] = power;
      power *= base;
    }
    base = power;
  }
}

static void prepare_stage_table(core_mc_plan *plan) {
  size_t stage = 0;
  for (uint32_t n = 1; n < MC_STAGE_TABLE; n++) {
    while (stage + 1 < plan->stages && plan->stage[stage + 1].first <= n) {
      stage++;
    }
    plan->stage_table[n] = (uint16_t)stage;
  }
}

static void prepare_edges(core_mc_plan *plan) {
  double *edges = plan->edges_squared_mfp2;
  const size_t count = (size_t)plan->request.edges.count;
  core_grid_radii(&plan->request.edges, 0, count, false, edges);
  for (size_t i = 0; i < count; i++) {
    edges[i] *= plan->request.sigma_t_per_mm;
    edges[i] *= edges[i];
  }
}

size_t mc_stage_of(const core_mc_plan *plan, uint32_t collisions) {
  if (collisions < MC_STAGE_TABLE) {
    return plan->stage_table[collisions];
  }
  size_t low = 0;
  for (size_t n = plan->stages; n > 1;) {
    const size_t half = n / 2;
    low = plan->stage[low + half].first <= collisions ? low + half : low;
    n -= half;
  }
  return low;
}

uint32_t mc_last_collision(const core_mc_plan *plan, uint32_t chance) {
  /* Finds the last stage that the photon lives to see. The first stage's survival is 1. */
  size_t low = 0;
  for (size_t n = plan->stages; n > 1;) {
    const size_t half = n / 2;
    low = plan->stage[low + half].survival > chance ? low + half : low;
    n -= half;
  }
  return low + 1 < plan->stages ? plan->stage[low + 1].first : plan->request.scatterings_max;
}

size_t mc_slot_of(const core_mc_plan *plan, double r_squared_mfp2) {
  const double *edges = plan->edges_squared_mfp2;
  size_t below = 0; /* number of edges below or at this radius */
  for (size_t n = plan->slots - 1; n > 0;) {
    const size_t half = n - n / 2;
    below = edges[below + half - 1] <= r_squared_mfp2 ? below + half : below;
    n -= half;
  }
  return below;
}

/* ---- plans ----------------------------------------------------------------------------------- */

core_mc_plan *core_mc_plan_create(const core_mc_request *request) {
  assert(core_mc_check(request).field == NULL);
  core_mc_plan *plan = calloc(1, sizeof *plan);
  if (plan == NULL) {
    return NULL;
  }
  plan->request = *request;
  fill_in_defaults(&plan->request);
  plan->albedos = request->albedo_count;
  plan->slots = (size_t)request->edges.count + 1;
  prepare_walk(plan);
  for (size_t k = 0; k < plan->albedos; k++) {
    prepare_powers(plan, k);
  }
  prepare_stages(plan);
  for (size_t k = 0; k < plan->albedos; k++) {
    prepare_stage_energies(plan, k);
  }
  prepare_stage_table(plan);
  prepare_edges(plan);
  plan->walks = plan->scattered_or_absorbed > 0 && largest_albedo(plan, plan->request.albedo) > 0;
  if (mc_is_layered(plan)) {
    prepare_layered_roulette(plan);
    plan->walks = true;
  }
  return plan;
}

void core_mc_plan_free(core_mc_plan *plan) {
  free(plan);
}
