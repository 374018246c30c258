/* bits [ISA]: evaluates a fixed, broad set of requests and prints a checksum of the bits of every
 * group of answers. Two machines, compilers or instruction sets that print the same gave the same
 * bits; tests/run-bits.sh compares them with each other and with record.txt. A commit that changes
 * the recorded bits says which and why. Each kernel also evaluates its values again in slices of any
 * length, at any alignment and in any lane, whatever stands beside: the program fails if one has
 * another bit.
 */
#include <float.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/core.h"
#include "core/gather/gather.h"
#include "core/montecarlo/montecarlo.h"
#include "core/solver/layer.h"
#include "core/solver/solver.h"
#include "core/splitmix.h"
#include "core/varying.h"
#include "tests/accuracy/inversion.h"

enum { MEDIA = 25, RADII = 257 };

/* Exit status where this machine lacks the instructions. */
enum { NOT_HERE = 77 };

/* Limits for models whose radii or preparation cost many times a dipole's, and for these only one
 * kind of moments. */
enum { COSTLY = 4, COSTLY_MEDIA = 8, SLOW_MEDIA = 1, TABLES = 2, COSTLY_RADII = 37 };

/* Adds bytes to a checksum: FNV-1a with 64 bits. */
static uint64_t checksum(uint64_t sum, const void *bytes, size_t n) {
  const unsigned char *at = bytes;
  for (size_t i = 0; i < n; i++) {
    sum = (sum ^ at[i]) * UINT64_C(0x100000001b3);
  }
  return sum;
}

static const uint64_t CHECKSUM_START = UINT64_C(0xcbf29ce484222325);

/* Returns a power of two with a random mantissa, so that numbers spread over many magnitudes
 * without pow(). */
static double spread(uint64_t *state, int least_exponent, int most_exponent) {
  const uint64_t biased = (uint64_t)(1023 + least_exponent) +
                          core_splitmix(state) % (uint64_t)(most_exponent - least_exponent + 1);
  const uint64_t bits = (biased << 52) | (core_splitmix(state) >> 12);
  double value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

/* One medium in four is at the ends of the domain. */
static core_medium random_medium(uint64_t *state) {
  const bool is_extreme = core_splitmix(state) % 4 == 0;
  const int most = is_extreme ? 46 : 20;
  core_medium medium = {.thickness_mm = 0};
  medium.sigma_s_per_mm = core_splitmix(state) % 16 == 0 ? 0 : spread(state, -most, most);
  medium.sigma_a_per_mm = core_splitmix(state) % 8 == 0 ? 0 : spread(state, -30, most);
  medium.g = is_extreme ? 1 - spread(state, -30, -1) : 1.9 * core_splitmix_f64(state) - 0.95;
  medium.eta = is_extreme ? spread(state, -1, 8) : 0.5 + 1.6 * core_splitmix_f64(state);
  return medium;
}

/* ---- values of a profile -------------------------------------------------------------------- */

static size_t bytes_of(const core_profile *profile, size_t n) {
  return n * (profile->evaluator == CORE_EVALUATOR_F64 ? sizeof(double) : sizeof(float));
}

static void put(const core_profile *profile, uint8_t *values, size_t i, double value) {
  const float narrow = (float)value;
  const bool f64 = profile->evaluator == CORE_EVALUATOR_F64;
  memcpy(values + bytes_of(profile, i), f64 ? (const void *)&value : &narrow, bytes_of(profile, 1));
}

/* Evaluates a quantity at n radii, or draws n radii (quantity 0). */
static void evaluate(const core_profile *profile, unsigned quantity, size_t n, const void *in,
                     void *out) {
  const bool f64 = profile->evaluator == CORE_EVALUATOR_F64;
  if (quantity == 0 && f64) {
    core_sample_f64(profile, n, in, out);
  } else if (quantity == 0) {
    core_sample_f32(profile, n, in, out);
  } else if (f64) {
    core_eval_f64(profile, quantity, n, in, out);
  } else {
    core_eval_f32(profile, quantity, n, in, out);
  }
}

/* Returns a radius, or a random number (quantity 0): one in eight at the ends of the formats. */
static double random_input(unsigned quantity, uint64_t *state) {
  static const double radii[] = {0,     -0.0, 5e-324, 2.3e-308, 1e-300, 1e-45,   1.2e-38,  1e-154,
                                 1e-30, 1e15, 1e19,   3e38,     1e150,  DBL_MAX, INFINITY, 1e-7};
  static const double shares[] = {0,           -0.0,  5e-324, 1e-300, 1e-45,     1.2e-38,
                                  1e-30,       1e-13, 1e-12,  .5,     1 - 1e-7f, 1 - 1e-12,
                                  FLT_EPSILON, 1,     .9999,  .999};
  const uint64_t which = core_splitmix(state) % (8 * 16);
  return which < 16      ? (quantity == 0 ? shares : radii)[which]
         : quantity == 0 ? core_splitmix_f64(state)
                         : spread(state, -40, 30);
}

enum {
  SLICE = 67,   /* four of the widest vectors and a remainder */
  OFFSETS = 16, /* all misalignments of the widest vector */
  ROOM = 2 * OFFSETS + 2 * SLICE,
  GUARD = 0xa5
};

/* Evaluates the values in slices, half of which have garbage in every second lane. */
static void check_slices(const core_profile *profile, unsigned quantity, size_t n,
                         const uint8_t *in, const uint8_t *out, uint64_t *state) {
  static const double garbage[] = {NAN, -NAN, INFINITY, -INFINITY, -1, -DBL_MAX, 5e-324, 1e-40};
  const size_t bytes = bytes_of(profile, 1);
  for (size_t first = 0, length; first < n; first += length) {
    const size_t step = 1 + core_splitmix(state) % 2, lane = core_splitmix(state) % step;
    const size_t from = core_splitmix(state) % OFFSETS, to = core_splitmix(state) % OFFSETS;
    _Alignas(64) uint8_t input[ROOM * sizeof(double)], output[ROOM * sizeof(double)];
    uint8_t before[sizeof input];
    length = core_splitmix(state) % (SLICE + 1);
    length = length < n - first ? length : n - first;
    for (size_t i = 0; i < ROOM; i++) {
      put(profile, input, i, garbage[core_splitmix(state) % 8]);
    }
    for (size_t i = 0; i < length; i++) {
      memcpy(input + (from + lane + i * step) * bytes, in + (first + i) * bytes, bytes);
    }
    memcpy(before, input, ROOM * bytes);
    memset(output, GUARD, sizeof output);
    evaluate(profile, quantity, length * step, input + from * bytes, output + to * bytes);
    bool good = memcmp(input, before, ROOM * bytes) == 0;
    for (size_t i = 0; i < length; i++) {
      good = good &&
             memcmp(output + (to + lane + i * step) * bytes, out + (first + i) * bytes, bytes) == 0;
    }
    for (size_t i = 0; i < sizeof output; i++) {
      good = good && (output[i] == GUARD || (i >= to * bytes && i < (to + length * step) * bytes));
    }
    if (!good) {
      fprintf(stderr, "bits: model %u, evaluator %u, quantity %u: other bits in a slice of %zu\n",
              profile->model, profile->evaluator, quantity, length);
      exit(EXIT_FAILURE);
    }
  }
}

/* Adds the values of a quantity, or radii that are drawn (quantity 0). */
static uint64_t add_values(uint64_t sum, const core_profile *profile, unsigned quantity,
                           uint64_t *state) {
  const bool transforms = quantity != 0 && core_call_cost(profile, quantity) > 0;
  const bool costly = transforms || core_radius_cost(profile, quantity) > COSTLY;
  const size_t n = costly ? COSTLY_RADII : RADII;
  _Alignas(64) uint8_t in[RADII * sizeof(double)], out[RADII * sizeof(double)];
  for (size_t i = 0; i < n; i++) {
    put(profile, in, i, random_input(quantity, state));
  }
  evaluate(profile, quantity, n, in, out);
  if (!transforms) { /* which have no lanes */
    check_slices(profile, quantity, n, in, out, state);
  }
  return checksum(sum, out, bytes_of(profile, n));
}

static uint64_t add_preparation(uint64_t sum, const core_profile *profile) {
  sum = checksum(sum, &profile->albedo, sizeof profile->albedo);
  sum = checksum(sum, &profile->numerical_error, sizeof profile->numerical_error);
  sum = checksum(sum, profile->numerical_errors, sizeof profile->numerical_errors);
  return checksum(sum, profile->lut, profile->lut_count * sizeof *profile->lut);
}

/* ---- models --------------------------------------------------------------------------------- */

/* Those of slow models take as long again to prepare: print_transport_with_g() has them. */
static bool has_derivatives(const core_choice *model) {
  return core_has_derivatives(model->id) &&
         !core_prepares_slowly(model->id, CORE_EVALUATOR_F64, NULL, NULL);
}

/* Returns for how many media a model is evaluated: fewer if it is slow. */
static int media_of(const core_choice *model, const core_choice *evaluator) {
  return core_prepares_slowly(model->id, CORE_EVALUATOR_F64, NULL, NULL) ? SLOW_MEDIA
         : evaluator->id == CORE_EVALUATOR_LUT                           ? TABLES
                                                                         : MEDIA;
}

/* Prepares a profile, with a thickness if the model needs one. Returns a fault for a medium outside
 * the domain of the model. */
static core_fault prepare(core_profile *profile, const core_isa *isa, const core_choice *model,
                          const core_choice *evaluator, const core_choice *moments,
                          const core_medium *medium) {
  core_parameters parameters = core_parameters_none();
  core_medium needed = *medium;
  const double sigma_t_prime = medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g);
  const core_fault needs =
      core_profile_check(model->id, moments->id, evaluator->id, medium, &parameters, NULL);
  if (needs.field != NULL && strcmp(needs.field, "thickness") == 0) {
    needed.thickness_mm = 3 / sigma_t_prime;
  }
  parameters.value[CORE_PARAMETER_DERIVATIVES] = has_derivatives(model) ? 1 : (double)NAN;
  return core_profile_prepare(profile, isa, model->id, moments->id, evaluator->id, &needed,
                              &parameters);
}

/* Returns whether a quantity of a model is compared. Model errors and what frequencies give are
 * computed from several profiles, and have no kernels. */
static bool is_compared(const core_choice *model, const core_choice *evaluator, unsigned quantity) {
  return (quantity & CORE_ARRAYS) != 0 &&
         (quantity & (CORE_QUANTITY_MODEL_ERRORS | CORE_PATHS | CORE_MODULATED)) == 0 &&
         (!core_wants_derivatives(quantity) || has_derivatives(model)) &&
         (evaluator->id != CORE_EVALUATOR_LUT || core_table_has(quantity));
}

/* Prints a checksum of all media for each quantity, and for samples, of one model, evaluator and
 * kind of moments. */
static void print_group(const core_isa *isa, const core_choice *model, const core_choice *evaluator,
                        const core_choice *moments) {
  enum { QUANTITIES = 64 };
  uint64_t state = 2012, sums[QUANTITIES], samples = CHECKSUM_START;
  int media = media_of(model, evaluator);
  for (size_t q = 0; q < QUANTITIES; q++) {
    sums[q] = CHECKSUM_START;
  }
  for (int i = 0; i < media; i++) {
    const core_medium medium = random_medium(&state);
    core_profile profile;
    const core_fault fault = prepare(&profile, isa, model, evaluator, moments, &medium);
    if (fault.field != NULL) {
      samples = checksum(samples, fault.field, strlen(fault.field));
      continue;
    }
    media = profile.cost > COSTLY && media > COSTLY_MEDIA ? COSTLY_MEDIA : media;
    for (size_t q = 0; core_quantities[q].name != NULL; q++) {
      if (is_compared(model, evaluator, core_quantities[q].id)) {
        sums[q] = add_values(sums[q], &profile, core_quantities[q].id, &state);
      }
    }
    samples = add_values(add_preparation(samples, &profile), &profile, 0, &state);
    core_profile_free(&profile);
  }
  for (size_t q = 0; core_quantities[q].name != NULL; q++) {
    if (is_compared(model, evaluator, core_quantities[q].id)) {
      printf("%s %s %s %s %016" PRIx64 "\n", model->name, evaluator->name, moments->name,
             core_quantities[q].name, sums[q]);
    }
  }
  printf("%s %s %s sample %016" PRIx64 "\n", model->name, evaluator->name, moments->name, samples);
}

static void print_grids(void) {
  uint64_t state = 1905;
  uint64_t sum = CHECKSUM_START;
  for (int i = 0; i < MEDIA; i++) {
    double r[RADII];
    const double start = spread(&state, -30, 10);
    const core_grid grid = {i % 2 ? CORE_SPACING_LINEAR : CORE_SPACING_LOGARITHMIC, RADII, start,
                            start * spread(&state, 0, 40)};
    core_grid_radii(&grid, 0, RADII, false, r);
    sum = checksum(sum, r, sizeof r);
  }
  printf("grids %016" PRIx64 "\n", sum);
}

static void print_inversions(const core_choice *model) {
  uint64_t state = 2001;
  uint64_t sum = CHECKSUM_START;
  for (int i = 0; i < MEDIA; i++) {
    const double albedo = core_splitmix_f64(&state);
    const inversion found =
        invert_albedo(model->id, CORE_MOMENTS_EXACT, albedo, spread(&state, -10, 10), 1.3);
    sum = checksum(sum, &found.medium, sizeof found.medium);
  }
  printf("%s inversions %016" PRIx64 "\n", model->name, sum);
}

/* Returns whether tables of a model are compared. The code for tables does not depend on the model,
 * so three models of different shapes are enough. */
static bool is_tabulated(const core_choice *model) {
  return model->id == CORE_MODEL_BETTER || model->id == CORE_MODEL_BURLEY ||
         model->id == CORE_MODEL_SKIN_RED;
}

/* Prints a checksum for each evaluator of transport with tissue's g, from the table of
 * solutions. */
static void print_transport_with_g(const core_isa *isa) {
  static const core_medium media[] = {{0.05, 9.5, 0.9, 1.4}, {2, 1.25, -0.3, 0.8}};
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    uint64_t sum = CHECKSUM_START, state = 1941;
    core_parameters parameters = core_parameters_none();
    parameters.value[CORE_PARAMETER_DERIVATIVES] = 1;
    parameters.value[CORE_PARAMETER_MHZ] = 100;
    for (size_t i = 0; i < sizeof media / sizeof media[0]; i++) {
      core_profile profile;
      if (core_profile_prepare(&profile, isa, CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                               evaluator->id, &media[i], &parameters)
              .field != NULL) {
        continue;
      }
      sum = add_preparation(sum, &profile);
      for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
        if ((quantity->id & CORE_ARRAYS) != 0 && quantity->id != CORE_QUANTITY_MODEL_ERRORS) {
          sum = add_values(sum, &profile, quantity->id, &state);
        }
      }
      sum = add_values(sum, &profile, 0, &state);
      core_profile_free(&profile);
    }
    printf("transport with g %s %016" PRIx64 "\n", evaluator->name, sum);
  }
}

/* Prints the checksum of media that vary, for one model and evaluator: of the words, all
 * quantities, sampled radii and media of colours. */
static void print_varying(const core_isa *isa, unsigned model, unsigned evaluator) {
  static const unsigned quantities[] = {CORE_QUANTITY_R, CORE_QUANTITY_CDF, CORE_QUANTITY_PDF,
                                        CORE_QUANTITY_RING};
  enum { QUANTITIES = sizeof quantities / sizeof quantities[0] };
  const core_colour what = {CORE_LIGHT_BEAM, true, CORE_LENGTH_FREE_PATH};
  double in[4][RADII], out[4][RADII];
  float in32[4][RADII], out32[4][RADII];
  uint8_t status[RADII];
  uint64_t state = 2016, sum = CHECKSUM_START;
  for (int i = 0; i < RADII; i++) {
    in[0][i] = spread(&state, -12, 4);
    in[1][i] = spread(&state, -8, 4);
    in[2][i] = spread(&state, -12, 6);
    in[3][i] = core_splitmix_f64(&state);
    for (int k = 0; k < 4; k++) {
      in32[k][i] = (float)in[k][i];
    }
  }
  core_varying varying;
  if (core_varying_prepare(&varying, isa, model, CORE_MOMENTS_EXACT, evaluator, 0.6, 1.4, NULL)
          .field != NULL) {
    return;
  }
  sum = checksum(sum, varying.words, varying.words_count * sizeof *varying.words);
  for (int i = 0; i < QUANTITIES + 2; i++) {
    if (evaluator == CORE_EVALUATOR_F64) {
      if (i < QUANTITIES) {
        core_varying_eval(&varying, quantities[i], RADII, in[0], in[1], in[2], out[0]);
      } else if (i == QUANTITIES) {
        core_varying_eval(&varying, CORE_QUANTITY_RADIUS, RADII, in[0], in[1], in[3], out[0]);
      } else {
        core_varying_invert(&varying, &what, RADII, in[3], in[2], out[0], out[1], out[2], status);
      }
      sum = checksum(sum, out[0], sizeof out[0]);
    } else {
      if (i < QUANTITIES) {
        core_varying_eval(&varying, quantities[i], RADII, in32[0], in32[1], in32[2], out32[0]);
      } else if (i == QUANTITIES) {
        core_varying_eval(&varying, CORE_QUANTITY_RADIUS, RADII, in32[0], in32[1], in32[3],
                          out32[0]);
      } else {
        core_varying_invert(&varying, &what, RADII, in32[3], in32[2], out32[0], out32[1], out32[2],
                            status);
      }
      sum = checksum(sum, out32[0], sizeof out32[0]);
    }
  }
  core_varying_free(&varying);
  printf("varying %u %u %016" PRIx64 "\n", model, evaluator, sum);
}

/* Prints checksums of the solver for any phase function: totals, and one wavenumber in real and in
 * complex numbers. */
static void print_anisotropic(const core_isa *isa) {
  static const double etas[] = {0.8, 1, 1.4};
  enum { ETAS = sizeof etas / sizeof etas[0], MOMENTS = 12 };
  const solver_phase phase = {0.8, 0, NULL};
  solver_total totals[ETAS];
  uint64_t sum = CHECKSUM_START;
  if (solver_totals(totals, isa, 0.05, &phase, etas, ETAS).field == NULL) {
    sum = checksum(sum, totals, sizeof totals);
  }
  double moment[MOMENTS] = {1};
  for (size_t l = 1; l < MOMENTS; l++) {
    moment[l] = 0.6 * moment[l - 1];
  }
  const expansion_rules rules = {4, 9, 3};
  const expansion_medium medium = {0.85, MOMENTS, moment, 0.05};
  const expansion_boundaries boundaries = {.count = ETAS, .etas = etas};
  expansion *expanded = solver_expansion_new(isa, &rules, &medium, &boundaries);
  layer_exitance exitance[ETAS];
  for (int imaginary = 0; imaginary < 2; imaginary++) {
    const double complex k = 1.25 + 0.125 * imaginary * (double complex)I;
    if (expanded != NULL && solver_layer_halfspace(expanded, k, 0.25, exitance)) {
      for (size_t eta = 0; eta < ETAS; eta++) {
        const double complex numbers[] = {exitance[eta].beam, exitance[eta].part[0],
                                          exitance[eta].diffuse};
        sum = checksum(sum, numbers, sizeof numbers);
      }
    }
  }
  solver_expansion_free(expanded);
  printf("anisotropic %016" PRIx64 "\n", sum);
}

/* Prints a checksum for each phase function of Monte Carlo. */
static void print_walks(const core_isa *isa) {
  static const struct {
    const char *name;
    unsigned phase;
    double share, g;
  } phases[] = {{"Henyey-Greenstein", 0, 0, 0},
                {"modified", CORE_PHASE_MODIFIED, 0.9, 0},
                {"two-term", CORE_PHASE_TWO_TERM, 0.95, -0.3}};
  const core_medium medium = {0.5, 9.5, 0.85, 1.4};
  for (size_t i = 0; i < sizeof phases / sizeof phases[0]; i++) {
    core_mc_request request = {.thickness_mm = (double)INFINITY,
                               .edges = {CORE_SPACING_LOGARITHMIC, 17, 0.01, 20},
                               .seed = 1968,
                               .phase = phases[i].phase,
                               .phase_share = phases[i].share,
                               .phase_g = phases[i].g};
    uint64_t sum = CHECKSUM_START;
    core_mc_request_medium(&request, &medium, 1);
    core_mc_plan *plan = core_mc_plan_create(&request);
    core_mc_total *total = core_mc_total_create(plan);
    core_mc_batch *batch = core_mc_batch_create(plan);
    core_mc_batch_start(batch, 0);
    while (!core_mc_batch_walk(batch, isa, 1000000)) {
    }
    core_mc_total_merge(total, batch);
    core_mc_ring rings[16];
    core_mc_total_rings(total, 0, CORE_MC_REFLECTED, rings);
    for (size_t j = 0; j < sizeof rings / sizeof rings[0]; j++) {
      sum = checksum(sum, &rings[j].R_per_mm2, sizeof rings[j].R_per_mm2);
    }
    core_mc_batch_free(batch);
    core_mc_total_free(total);
    core_mc_plan_free(plan);
    printf("walks %s %016" PRIx64 "\n", phases[i].name, sum);
  }
}

/* Light gathered from points of different sizes of clusters, with each evaluator. */
static void print_gathered(const core_isa *isa) {
  enum { POINTS = 3000, QUERIES = 100, CHANNELS = 2 };
  static double xyz[3 * POINTS], M[CHANNELS * QUERIES];
  static float power[CHANNELS * POINTS], bound[CHANNELS * QUERIES];
  uint64_t state = 23;
  for (size_t i = 0; i < POINTS; i++) {
    const double size = spread(&state, -8, 4);
    for (size_t k = 0; k < 3; k++) {
      xyz[3 * i + k] = (double)(i % 5) + size * core_splitmix_f64(&state);
    }
    for (size_t c = 0; c < CHANNELS; c++) {
      power[CHANNELS * i + c] = (float)core_splitmix_f64(&state);
    }
  }
  core_gather_points *points = core_gather_points_create(POINTS, xyz, CHANNELS, power);
  while (!core_gather_points_build(points, 1000000)) {
  }
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    const core_medium media[CHANNELS] = {{0.17, 0.88, 0, 1.3}, {0.03, 7.4, 0.9, 1.4}};
    core_profile profiles[CHANNELS];
    const core_profile *list[CHANNELS];
    for (size_t c = 0; c < CHANNELS; c++) {
      core_profile_prepare(&profiles[c], isa, CORE_MODEL_BETTER, CORE_MOMENTS_EXACT, evaluator->id,
                           &media[c], NULL);
      list[c] = &profiles[c];
    }
    uint64_t sum = CHECKSUM_START;
    for (double tolerance = 1e-2; tolerance > 1e-6; tolerance *= 0.1) {
      core_gather_sum *gather;
      core_gather_visits visits = {0};
      core_gather_sum_prepare(&gather, isa, CHANNELS, list, tolerance < 1e-5 ? 0 : tolerance);
      core_gather_scratch *scratch = core_gather_scratch_create(gather, points);
      core_gather(gather, points, scratch, QUERIES, NULL, xyz, M, bound, &visits);
      core_gather_scratch_free(scratch);
      sum = checksum(sum, M, sizeof M);
      sum = checksum(sum, bound, sizeof bound);
      for (size_t c = 0; c < CHANNELS; c++) {
        const double error = core_gather_error(gather, points, c, &visits);
        sum = checksum(sum, &error, sizeof error);
      }
      core_gather_sum_free(gather);
    }
    for (size_t c = 0; c < CHANNELS; c++) {
      core_profile_free(&profiles[c]);
    }
    printf("gathered %s %016" PRIx64 "\n", evaluator->name, sum);
  }
  core_gather_points_free(points);
}

int main(int argc, char **argv) {
  const core_isa *isa = core_isa_select(argc > 1 ? argv[1] : "portable");
  if (isa == NULL) {
    fprintf(stderr, "bits: this machine cannot run %s\n", argv[1]);
    return NOT_HERE;
  }
  static const unsigned varied[] = {CORE_MODEL_BETTER, CORE_MODEL_BURLEY, CORE_MODEL_TRANSPORT};
  for (size_t i = 0; i < sizeof varied / sizeof varied[0]; i++) {
    print_varying(isa, varied[i], CORE_EVALUATOR_F64);
    print_varying(isa, varied[i], CORE_EVALUATOR_F32);
  }
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    const bool all_moments = model->id == CORE_MODEL_CLASSICAL || model->id == CORE_MODEL_BETTER;
    for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
      for (const core_choice *moments = core_moments_list; moments->name != NULL; moments++) {
        const bool one_kind = !all_moments || evaluator->id == CORE_EVALUATOR_LUT;
        const bool is_due = evaluator->id != CORE_EVALUATOR_LUT || is_tabulated(model);
        if (is_due && (!one_kind || moments->id == CORE_MOMENTS_EXACT)) {
          print_group(isa, model, evaluator, moments);
        }
      }
    }
    if (all_moments) {
      print_inversions(model);
    }
  }
  print_transport_with_g(isa);
  print_grids();
  print_anisotropic(isa);
  print_walks(isa);
  print_gathered(isa);
  return EXIT_SUCCESS;
}
