/* bits [ISA [PART]]: evaluates a fixed, broad set of requests and prints a checksum of the bits of every
 * group of answers. Two machines, compilers or instruction sets that print the same gave the same
 * bits; tests/run-bits.sh compares them with each other and with record.txt. A commit that changes
 * the recorded bits says which and why. Each kernel also evaluates its values again in slices of any
 * length, at any alignment and in any lane, whatever stands beside: the program fails if one has
 * another bit. PART is a part of the groups, for machines that are emulated: kernels (the models' and
 * those of media that vary), f64 (double precision of the models alone), solutions or others; layers, a
 * fit that takes seconds, is in no other part. ISA - is the widest that the machine has.
 */
#include <assert.h>
#include <float.h>
#include <inttypes.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/choose.h"
#include "core/draw.h"
#include "core/fit/layers.h"
#include "core/fit/spectral.h"
#include "core/gather/gather.h"
#include "core/montecarlo/montecarlo.h"
#include "core/ruler.h"
#include "core/splitmix.h"
#include "core/varying.h"
#include "tests/accuracy/inversion.h"

enum { MEDIA = 12, RADII = 131 };

/* Exit status where this machine lacks the instructions. */
enum { NOT_HERE = 77 };

/* Limits for models whose radii or preparation cost many times a dipole's, and for these only one
 * kind of moments. */
enum { COSTLY = 4, COSTLY_MEDIA = 4, SLOW_MEDIA = 1, TABLES = 2, COSTLY_RADII = 19 };

/* Adds bytes to a checksum: FNV-1a with 64 bits. */
static uint64_t checksum(uint64_t sum, const void *bytes, size_t n) {
  const unsigned char *at = bytes;
  for (size_t i = 0; i < n; i++) {
    sum = (sum ^ at[i]) * UINT64_C(0x100000001b3);
  }
  return sum;
}

static const uint64_t CHECKSUM_START = UINT64_C(0xcbf29ce484222325);

/* Adds doubles, and integers in 8 bytes. All that is not a number counts as the same: its sign is the
 * machine's. */
static uint64_t add_numbers(uint64_t sum, const void *numbers, size_t bytes) {
  for (size_t i = 0; i < bytes; i += sizeof(double)) {
    double number;
    memcpy(&number, (const char *)numbers + i, sizeof number);
    number = isnan(number) ? (double)NAN : number;
    sum = checksum(sum, &number, sizeof number);
  }
  return sum;
}

static uint64_t add_fault(uint64_t sum, core_fault fault) {
  const char *const texts[] = {fault.field, fault.allowed};
  for (size_t i = 0; i < (fault.field != NULL ? 2 : 0); i++) {
    sum = checksum(sum, texts[i], strlen(texts[i]));
  }
  return add_numbers(sum, &fault.index, sizeof fault.index);
}

static void print_sum(const char *group, const char *name, uint64_t sum) {
  printf("%s %s %016" PRIx64 "\n", group, name, sum);
}

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

/* Of twelve media three are at the ends of the domain, two do not absorb and two do not scatter. */
static core_medium random_medium(uint64_t *state, int i) {
  const bool is_extreme = i % 4 == 3;
  const int most = is_extreme ? 46 : 20;
  core_medium medium = {.thickness_mm = 0};
  medium.sigma_s_per_mm = i % 9 == 2 ? 0 : spread(state, -most, most);
  medium.sigma_a_per_mm = i % 6 == 1 ? 0 : spread(state, -30, most);
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

/* Adds what callers read of a profile, its table, and the errors that it states near the source to
 * beyond its reach. */
static uint64_t add_preparation(uint64_t sum, const core_profile *profile) {
  static const double ends[][2] = {{1, 0},       {0, 0},    {1e-300, 1}, {1e-3, 0.4},
                                   {0.02, 17.5}, {30, 200}, {1, 1e4},    {1, 1e9}};
  const core_medium *medium = &profile->medium;
  const double mfp_mm = 1 / (medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g));
  sum = checksum(sum, &profile->notes, sizeof profile->notes);
  sum = add_numbers(sum, &profile->albedo,
                    offsetof(core_profile, kernels) - offsetof(core_profile, albedo));
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    for (size_t i = 0; i < sizeof ends / sizeof ends[0]; i++) {
      const core_radii_range radii = {ends[i][0] * mfp_mm, ends[i][1] * mfp_mm};
      if ((quantity->id & CORE_MODULATED) == 0 || profile->modulation != NULL) {
        const core_stated_errors errors = core_profile_errors(profile, quantity->id, radii);
        sum = add_numbers(sum, &errors, sizeof errors);
      }
    }
  }
  return checksum(sum, profile->lut, profile->lut_count * sizeof *profile->lut);
}

/* Adds how far a profile is from transport, where that needs no solving. */
static uint64_t add_model_errors(uint64_t sum, const core_isa *isa, const core_profile *profile) {
  const core_medium *medium = &profile->medium;
  const double mfp_mm = 1 / (medium->sigma_a_per_mm + medium->sigma_s_per_mm * (1 - medium->g));
  const core_radii_range range = {0.01 * mfp_mm, 30 * mfp_mm};
  const core_requested_radii requested = {
      .grid = {CORE_SPACING_LOGARITHMIC, 60, range.least_mm, range.most_mm}, .range = range};
  const core_parameters none = core_parameters_none();
  core_profile ruler;
  if (!core_ruler_is_needed(profile->model, &none, medium, false) ||
      core_profile_prepare(&ruler, isa, CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT,
                           CORE_EVALUATOR_F64, medium, NULL)
              .field != NULL) {
    return sum;
  }
  const core_model_errors errors = core_model_errors_measure(profile, &ruler);
  const double gathered = core_gather_model_error(&errors, medium);
  sum =
      add_numbers(add_numbers(sum, errors.error, sizeof errors.error), &gathered, sizeof gathered);
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    const double error[] = {
        core_model_error(profile, &ruler, quantity->id, &requested),
        core_model_errors_of(&errors, medium, quantity->id, (core_radii_range){mfp_mm, mfp_mm})};
    sum = add_numbers(sum, error, sizeof error);
  }
  core_profile_free(&ruler);
  return sum;
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
  if (model->id == CORE_MODEL_TRANSPORT_TRANSMITTED) { /* which is solved, as coarsely as may be */
    parameters.value[CORE_PARAMETER_TOLERANCE] = 0.5;
  }
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
  uint64_t state = 2012, sums[QUANTITIES];
  uint64_t samples = CHECKSUM_START, errors = CHECKSUM_START;
  int media = media_of(model, evaluator);
  for (size_t q = 0; q < QUANTITIES; q++) {
    sums[q] = CHECKSUM_START;
  }
  for (int i = 0; i < media; i++) {
    const core_medium medium = random_medium(&state, i);
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
    errors = i < COSTLY_MEDIA ? add_model_errors(errors, isa, &profile) : errors;
    core_profile_free(&profile);
  }
  for (size_t q = 0; core_quantities[q].name != NULL; q++) {
    if (is_compared(model, evaluator, core_quantities[q].id)) {
      printf("%s %s %s %s %016" PRIx64 "\n", model->name, evaluator->name, moments->name,
             core_quantities[q].name, sums[q]);
    }
  }
  printf("%s %s %s sample %016" PRIx64 "\n", model->name, evaluator->name, moments->name, samples);
  printf("%s %s %s model_errors %016" PRIx64 "\n", model->name, evaluator->name, moments->name,
         errors);
}

/* Whether work is cut in parts, and done in another order, with an instruction set: as it then has to
 * equal the portable one, that changes nothing. */
static bool is_cut(const core_isa *isa) {
  return core_isa_name(isa)[0] != 'p';
}

static void print_grids(const core_isa *isa) {
  uint64_t state = 1905;
  uint64_t sum = CHECKSUM_START;
  for (int i = 0; i < MEDIA; i++) {
    double r[RADII];
    const double start = spread(&state, -30, 10);
    const core_grid grid = {i % 2 ? CORE_SPACING_LINEAR : CORE_SPACING_LOGARITHMIC, RADII, start,
                            start * spread(&state, 0, 40)};
    const size_t first = is_cut(isa) ? 10 * (size_t)i : 0;
    core_grid_radii(&grid, 0, first, false, r);
    core_grid_radii(&grid, first, RADII - first, false, r + first);
    sum = checksum(sum, r, sizeof r);
  }
  printf("grids %016" PRIx64 "\n", sum);
}

static void print_inversions(const core_choice *model) {
  uint64_t state = 2001;
  uint64_t sum = CHECKSUM_START;
  for (int i = 0; i < MEDIA; i++) {
    const double albedo = core_splitmix_f64(&state);
    core_inverter inverter;
    core_inverter_start(&inverter, model->id, CORE_MOMENTS_EXACT, CORE_LIGHT_BEAM, i % 2, 0.1 * i,
                        1.3, 0.7);
    inversion_run(&inverter);
    inverter.finds_errors = true;
    if (!core_inverter_seek(&inverter, albedo, 1 + i % 4, spread(&state, -10, 10))) {
      inversion_run(&inverter);
    }
    sum = add_numbers(sum, &inverter.medium, sizeof inverter.medium);
    sum = add_numbers(sum, &inverter.albedo, 5 * sizeof inverter.albedo);
  }
  printf("%s inversions %016" PRIx64 "\n", model->name, sum);
}

/* Returns whether tables of a model are compared. The code for tables does not depend on the model,
 * so three models of different shapes are enough. */
static bool is_tabulated(const core_choice *model) {
  return model->id == CORE_MODEL_BETTER || model->id == CORE_MODEL_BURLEY ||
         model->id == CORE_MODEL_SKIN_RED;
}

/* Prints the checksum of media that vary, for one model and evaluator: of the words, all
 * quantities, sampled radii and media of colours. */
static void print_varying(const core_isa *isa, unsigned model, unsigned evaluator) {
  static const unsigned quantities[] = {CORE_QUANTITY_R,      CORE_QUANTITY_CDF,
                                        CORE_QUANTITY_PDF,    CORE_QUANTITY_RING,
                                        CORE_QUANTITY_ALBEDO, CORE_QUANTITY_RADIUS};
  enum { QUANTITIES = sizeof quantities / sizeof quantities[0] };
  static double in[4][RADII], out[3][RADII];
  static float in32[4][RADII], out32[3][RADII];
  const bool f64 = evaluator == CORE_EVALUATOR_F64;
  const size_t bytes = f64 ? sizeof out[0] : sizeof out32[0];
  const void *at[4] = {in32[0], in32[1], in32[2], in32[3]};
  void *to[3] = {out32[0], out32[1], out32[2]};
  uint8_t status[RADII];
  uint64_t state = 2016, sum = CHECKSUM_START;
  for (int i = 0; i < RADII; i++) {
    in[0][i] = spread(&state, -12, 4);
    in[1][i] = spread(&state, -8, 4);
    in[2][i] = spread(&state, -12, 6);
    in[3][i] = core_splitmix_f64(&state);
    for (int k = 0; k < 4; k++) {
      in32[k][i] = (float)in[k][i];
      at[k] = f64 ? (const void *)in[k] : in32[k];
    }
  }
  for (int k = 0; k < 3 && f64; k++) {
    to[k] = out[k];
  }
  core_varying varying;
  if (core_varying_prepare(&varying, isa, model, CORE_MOMENTS_EXACT, evaluator, 0.6, 1.4, NULL)
          .field != NULL) {
    return;
  }
  sum = checksum(sum, varying.words, varying.words_count * sizeof *varying.words);
  core_varying_range range;
  for (int drawn = 1; drawn >= 0; drawn--) {
    core_varying_check(&varying, drawn, RADII, at[0], at[1], at[2 + drawn], status, &range);
    sum = checksum(add_numbers(sum, &range, sizeof range), status, sizeof status);
  }
  for (int i = 0; i < QUANTITIES; i++) {
    const double error = core_varying_error(&varying, quantities[i], &range);
    core_varying_eval(&varying, quantities[i], RADII, at[0], at[1],
                      at[quantities[i] == CORE_QUANTITY_RADIUS ? 3 : 2], to[0]);
    sum = checksum(add_numbers(sum, &error, sizeof error), to[0], bytes);
  }
  if (f64) {
    core_varying_gradient_f64(&varying, RADII, in[0], in[1], in[2],
                              &(core_gradient){out[0], out[1], out[2]});
    sum = add_numbers(sum, out, sizeof out);
  }
  for (unsigned i = 0; i < 2 * CORE_LIGHTS * 4; i++) {
    const core_colour what = {i % CORE_LIGHTS, i / CORE_LIGHTS % 2, 1 + i / CORE_LIGHTS / 2};
    if (core_colour_check(&varying, &what).field == NULL) {
      core_varying_invert(&varying, &what, RADII, at[3], at[2], to[0], to[1], to[2], status);
      sum = checksum(sum, status, sizeof status);
      for (int k = 0; k < 3; k++) {
        sum = checksum(sum, to[k], bytes);
      }
    }
  }
  core_varying_free(&varying);
  printf("varying %u %u %016" PRIx64 "\n", model, evaluator, sum);
}

/* Prints checksums of Monte Carlo. Instruction sets cut the walks in different slices. */
static void print_walks(const core_isa *isa) {
  const uint64_t slice = is_cut(isa) ? 777 : 1000000;
  static const struct {
    const char *name;
    core_mc_request request;
    size_t count;
    core_medium layer[2];
  } rows[] = {
      {"Henyey-Greenstein", {0}, 1, {{0.5, 9.5, 0.85, 1.4}}},
      {"modified", {.phase = CORE_PHASE_MODIFIED, .phase_share = 0.9}, 1, {{0.5, 9.5, 0.85, 1.4}}},
      {"two-term",
       {.phase = CORE_PHASE_TWO_TERM, .phase_share = 0.95, .phase_g = -0.3},
       1,
       {{0.5, 9.5, 0.85, 1.4}}},
      {"slab", {.eta_below = 1.2, .aperture = 0.5}, 1, {{0.5, 9.5, -0.3, 0.8, 0.4}}},
      {"layers",
       {.scatterings_max = 60, .roulette_weight = 0.5},
       2,
       {{1.5, 20, 0.8, 1.4, 0.06}, {0.1, 15, 0, 1.33, 1}}}};
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    core_mc_request request = rows[i].request;
    request.edges = (core_grid){CORE_SPACING_LOGARITHMIC, 17, 0.01, 20};
    request.seed = 1968;
    uint64_t sum = CHECKSUM_START;
    core_mc_request_medium(&request, rows[i].layer, rows[i].count);
    request.albedo_count = request.thickness_mm < (double)INFINITY ? 1 : 2;
    request.albedo[1] = 0.5;
    core_mc_plan *plan = core_mc_plan_create(&request);
    core_mc_total *total = core_mc_total_create(plan);
    core_mc_batch *batch = core_mc_batch_create(plan);
    for (uint64_t index = 0; index < 2; index++) {
      core_mc_batch_start(batch, index);
      while (!core_mc_batch_walk(batch, isa, slice)) {
      }
      core_mc_total_merge(total, batch);
    }
    for (size_t k = 0; k < request.albedo_count * CORE_MC_SIDES; k++) {
      core_mc_energy energy;
      core_mc_ring rings[16];
      core_mc_total_energy(total, k / CORE_MC_SIDES, &energy);
      core_mc_total_rings(total, k / CORE_MC_SIDES, k % CORE_MC_SIDES, rings);
      sum = add_numbers(add_numbers(sum, &energy, sizeof energy), rings, sizeof rings);
    }
    core_mc_batch_free(batch);
    core_mc_total_free(total);
    core_mc_plan_free(plan);
    print_sum("walks", rows[i].name, sum);
  }
}

/* Light gathered from points of different sizes of clusters, one of which is within one key of a
 * Morton order, with each evaluator; two of the channels' powers are proportional. */
static void print_gathered(const core_isa *isa) {
  enum { POINTS = 3000, QUERIES = 100, CHANNELS = 3 };
  static double xyz[3 * POINTS], M[CHANNELS * QUERIES];
  static float power[CHANNELS * POINTS], bound[CHANNELS * QUERIES];
  uint64_t state = 23;
  for (size_t i = 0; i < POINTS; i++) {
    const double size = i < 2900 ? spread(&state, -8, 4) : 1e-9;
    for (size_t k = 0; k < 3; k++) {
      xyz[3 * i + k] = (double)(i < 2900 ? i % 5 : 2) + size * core_splitmix_f64(&state);
    }
    for (size_t c = 0; c < CHANNELS; c++) {
      power[CHANNELS * i + c] = (float)core_splitmix_f64(&state);
    }
    power[CHANNELS * i + 2] = 3 * power[CHANNELS * i];
  }
  static double queries[3 * QUERIES];
  static uint32_t order[QUERIES];
  /* Half of them are so close that they are summed together, and three are asked twice. */
  for (size_t i = 0; i < 3 * QUERIES; i++) {
    queries[i] = i < 150   ? xyz[i]
                 : i < 291 ? xyz[i % 3] + 0.05 * core_splitmix_f64(&state)
                           : queries[i - 291];
    order[i / 3] = (uint32_t)(i / 3);
  }
  core_gather_points *points = core_gather_points_create(POINTS, xyz, CHANNELS, power);
  while (!core_gather_points_build(points, is_cut(isa) ? 777 : 1000000)) {
  }
  uint64_t of_points = CHECKSUM_START;
  for (int own = 0; own < 2; own++) {
    core_gather_order(own ? points : NULL, QUERIES, queries, order);
    of_points = checksum(of_points, order, sizeof order);
  }
  const size_t bytes = core_gather_points_bytes(points);
  print_sum("gathered", "points", checksum(of_points, &bytes, sizeof bytes));
  for (size_t i = 0; i < QUERIES && !is_cut(isa); i++) {
    order[i] = (uint32_t)i;
  }
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    const core_medium media[CHANNELS] = {
        {0.17, 0.88, 0, 1.3}, {0.03, 7.4, 0.9, 1.4}, {1, 2, 0, 1.4}};
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
      for (size_t done = 0; done < QUERIES;) {
        double work = is_cut(isa) ? 7777 : (double)INFINITY;
        done += core_gather_on(gather, points, scratch, QUERIES - done, order + done, queries, M,
                               bound, &visits, &work);
      }
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

/* ---- answers with a way of their own, with their errors --------------------------------------- */

/* Prints a checksum of the preparation, all quantities and samples of layers, of media from the table
 * of solutions and beyond it, of modulated light and of limits. */
static void print_answers(const core_isa *isa) {
  enum {
    OFF = CORE_PARAMETER_TOLERANCE, /* 0.5: the coarsest solution */
    MHZ = CORE_PARAMETER_MHZ,
    INDEX = CORE_PARAMETER_INDEX,
    BELOW = CORE_PARAMETER_ETA_BELOW,
    LAYER = CORE_PARAMETER_DERIVATIVE_LAYER
  };
  static const struct {
    const char *name;
    unsigned model, evaluator, layers;
    core_medium layer[2];
    unsigned given[2];
    double value[2];
  } rows[] = {{"table f64", 29, 1, 1, {{0.05, 9.5, 0.9, 1.4}}, {MHZ}, {100}},
              {"table f32", 29, 2, 1, {{2, 1.25, -0.3, 0.8}}, {MHZ}, {100}},
              {"table lut", 29, 3, 1, {{0.05, 9.5, 0.9, 1.4}}, {MHZ}, {100}},
              {"gamma", 29, 1, 1, {{0.05, 9.5, 0.9, 1.4}}, {CORE_PARAMETER_GAMMA}, {1.7}},
              {"dark", 29, 1, 1, {{4, 1, 0.2, 1.4}}, {CORE_PARAMETER_COS_IN}, {0.3}},
              {"white", 29, 1, 1, {{0, 9.5, 0.9, 1.4}}, {CORE_PARAMETER_COS_OUT}, {0.6}},
              {"solved", 29, 1, 1, {{0.3, 5, 0.6, 3}}, {OFF}, {0.5}},
              {"black", 29, 1, 1, {{30, 2.5, 0.6, 2.5}}, {OFF}, {0.5}},
              {"slab", 29, 1, 1, {{0.05, 10, 0.8, 1.4, 2}}, {OFF, BELOW}, {0.5, 1.2}},
              {"slab below", 30, 2, 1, {{0.1, 2, -0.3, 1.4, 1}}, {OFF}, {0.5}},
              {"two", 29, 1, 2, {{1, 2, .2, 1.1, 1}, {2, .5, 0, 1}}, {OFF, LAYER}, {.5, 2}},
              {"modulated", 2, 1, 1, {{0.01, 9.5, 0.9, 1.4}}, {MHZ, INDEX}, {300, 1.33}},
              {"modulated sum", 14, 2, 1, {{0.5, 2, 0.5, 1.4}}, {MHZ}, {5000}},
              {"white sum", 14, 1, 1, {{0, 9.5, 0.9, 1.4}}, {INDEX}, {1.4}},
              {"albedo", 18, 1, 1, {{0.1, 2, 0, 1.4}}, {CORE_PARAMETER_SURFACE_ALBEDO}, {0.3}},
              {"finer table", 2, 3, 1, {{0.1, 2, 0, 1.4}}, {OFF}, {1e-5}}};
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    core_parameters parameters = core_parameters_none();
    uint64_t state = 1950, sum = CHECKSUM_START;
    /* Derivatives take several solutions, so layers alone have them among what is solved. */
    const bool derives =
        core_has_derivatives(rows[i].model) && (rows[i].layers > 1 || rows[i].given[0] != OFF);
    core_profile profile;
    const atomic_bool stop = true; /* at first */
    parameters.layer_count = rows[i].layers;
    parameters.value[CORE_PARAMETER_DERIVATIVES] = derives ? 1 : (double)NAN;
    for (size_t k = 0; k < 2 && rows[i].given[k] != 0; k++) {
      parameters.value[rows[i].given[k]] = rows[i].value[k];
    }
    core_fault fault =
        core_profile_prepare_until(&profile, isa, rows[i].model, CORE_MOMENTS_EXACT,
                                   rows[i].evaluator, rows[i].layer, &parameters, &stop);
    sum = add_fault(sum, fault);
    if (fault.field == NULL) { /* nothing takes long */
      core_profile_free(&profile);
    }
    fault = core_profile_prepare(&profile, isa, rows[i].model, CORE_MOMENTS_EXACT,
                                 rows[i].evaluator, rows[i].layer, &parameters);
    assert(fault.field == NULL);
    sum = add_preparation(sum, &profile);
    if (i < 8) {
      double diffuse[2]; /* and its error */
      core_albedo(isa, rows[i].model, CORE_MOMENTS_EXACT, CORE_LIGHT_DIFFUSE, rows[i].layer,
                  &diffuse[0], &diffuse[1]);
      sum = add_numbers(sum, diffuse, sizeof diffuse);
    }
    for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
      if ((quantity->id & CORE_ARRAYS & ~(unsigned)CORE_QUANTITY_MODEL_ERRORS) != 0 &&
          (derives || !core_wants_derivatives(quantity->id)) &&
          core_paths_check(rows[i].model, quantity->id, rows[i].layer, &parameters).field == NULL) {
        sum = add_values(sum, &profile, quantity->id, &state);
      }
    }
    print_sum("answers", rows[i].name, add_values(sum, &profile, 0, &state));
    core_profile_free(&profile);
  }
}

/* Sets values[n] to readings of a quantity with up to 2 % of noise. */
static void take_readings(const core_isa *isa, unsigned model, const core_medium *medium,
                          double mhz, unsigned quantity, size_t n, const double *at,
                          double *values) {
  core_parameters parameters = core_parameters_none();
  uint64_t state = 1963;
  core_profile profile;
  parameters.value[CORE_PARAMETER_MHZ] = mhz;
  core_profile_prepare(&profile, isa, model, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, medium,
                       &parameters);
  core_eval_f64(&profile, quantity, n, at, values);
  for (size_t i = 0; i < n; i++) {
    values[i] *= 1 + 0.02 * core_splitmix_f64(&state);
  }
  core_profile_free(&profile);
}

/* Prints checksums of fits, then of the same refined as if the noise were small, and of readings at
 * random. */
static void print_fits(const core_isa *isa) {
  uint64_t state = 1944;
  enum { READINGS = 6 };
  static const double near[READINGS] = {0.8, 1.5, 3, 5, 8, 12},
                      f[READINGS] = {0, 0.05, 0.1, 0.2, 1};
  static const double small[READINGS] = {0.4, 0.4, 0.4, 0.6, 0.6, 1}, wide[READINGS] = {1, 1, 2, 2};
  static const struct {
    const char *name;
    core_fit_design design;
  } rows[] = {
      {"two", {29, 1, 0.8, 1.4, 0, NULL, 1, 2, near, NULL, NULL, 0, 1}},
      {"fibres", {29, 1, 0.8, 1.4, 0, NULL, 1, 6, near, small, wide, 0.4, 2}},
      {"ratios", {2, 1, 0, 1.4, 0, NULL, 1, 6, near, small, wide, 0, 3, {0.02, 1.2, 0, 1.4}}},
      {"waves", {29, 1, 0.9, 1.4, 0, NULL, 2, 5, f, NULL, NULL, 0, 1}},
      {"dipole", {1, 1, 0, 1.4, 0, NULL, 1, 5, near, NULL, NULL, 0, 2}},
      {"dipole waves", {2, 1, 0, 1.4, 0, NULL, 2, 5, f, NULL, NULL, 0, 2}},
      {"sum", {14, 1, 0.5, 1.4, 0, NULL, 1, 4, near, NULL, NULL, 0, 1}},
      {"slab", {27, 1, 0, 1.4, 5, NULL, 1, 4, near, NULL, NULL, 0, 1}}};
  for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
    const core_fit_design design = rows[i].design;
    const core_medium medium = {0.03, 1 / (1 - design.g), design.g, 1.4, design.thickness_mm};
    double values[READINGS], known[READINGS], errors[READINGS], residuals[READINGS] = {0};
    core_fit *fit;
    const unsigned quantity = design.axis == 1 ? CORE_QUANTITY_R : CORE_QUANTITY_TRANSFER;
    uint64_t sum = add_fault(CHECKSUM_START, core_fit_create(&fit, isa, &design));
    take_readings(isa, design.model, &medium, NAN, quantity, design.count, design.at, values);
    const bool ratios = design.scale == CORE_FIT_SCALE_REFERENCE;
    take_readings(isa, design.model, ratios ? &design.reference : &medium, NAN, quantity,
                  design.count, design.at, known);
    for (double share = 0.02; share > 1e-5; share *= 0.01) {
      core_fit_result result = {0};
      core_medium next;
      for (size_t k = 0; k < design.count; k++) {
        values[k] /= share > 0.01 && ratios ? known[k] : 1;
        errors[k] = share * values[k];
      }
      core_fit_run(fit, values, errors, &result, residuals);
      bool more = core_fit_wants_exact(fit, values, errors, &result, &next);
      for (int step = 0; more && step < CORE_FIT_REFINE_MOST; step++) {
        core_profile profile;
        core_profile_prepare(&profile, isa, design.model, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64,
                             &next, NULL);
        more = core_fit_refine(fit, &profile, values, errors, &result, residuals, &next);
        core_profile_free(&profile);
      }
      sum = add_numbers(add_numbers(sum, &result, offsetof(core_fit_result, notes)), residuals,
                        design.count * sizeof *residuals);
    }
    for (size_t set = 0; set < (i == 0 ? 100 : i < 5 ? 3 : 0); set++) { /* of no medium */
      core_fit_result result = {0};
      for (size_t k = 0; k < design.count; k++) {
        values[k] = known[k] * spread(&state, -8, 5);
        errors[k] = values[k] * spread(&state, -9, 0);
      }
      core_fit_run(fit, values, errors, &result, residuals);
      sum = add_numbers(sum, &result, offsetof(core_fit_result, notes));
    }
    core_fit_free(fit);
    print_sum("fits", rows[i].name, sum);
  }
}

/* Prints a checksum of a fit of layers: a slab's thickness, its least absorption and a free factor. */
static void print_layers(const core_isa *isa) {
  enum { READINGS = 6 };
  static const double at[READINGS] = {0.3, 0.4, 0.6, 0.8, 1, 1.5},
                      off[READINGS] = {1, 1.01, 1.02, 1.01, 1, 1.02};
  static const core_medium slab = {1e-7, 2, 0, 1, 1};
  double values[READINGS], errors[READINGS], residuals[READINGS] = {0};
  core_parameters parameters = core_parameters_none();
  core_profile profile;
  parameters.value[CORE_PARAMETER_TOLERANCE] = 0.5;
  core_profile_prepare(&profile, isa, CORE_MODEL_TRANSPORT, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64,
                       &slab, &parameters);
  core_eval_f64(&profile, CORE_QUANTITY_R, READINGS, at, values);
  core_profile_free(&profile);
  for (size_t i = 0; i < READINGS; i++) {
    errors[i] = 0.05 * values[i];
    values[i] *= off[i];
  }
  const unsigned unknowns = CORE_UNKNOWN_THICKNESS_1 | CORE_UNKNOWN_SIGMA_A_1;
  const core_layers_fit_request request = {
      CORE_FIT_SCALE_FREE, unknowns, &slab, 1, READINGS, at, values, errors};
  core_layers_fit fit = {0};
  uint64_t sum =
      add_fault(CHECKSUM_START, core_layers_fit_run(&fit, isa, &request, residuals, NULL));
  sum = add_numbers(add_numbers(sum, &fit, sizeof fit), residuals, sizeof residuals);
  print_sum("fits", "layers", sum);
}

/* Prints a checksum of each tissue's media and of a fit of its spectra: by transport, with a free
 * factor, or of modulated light. */
static void print_spectra(const core_isa *isa) {
  enum { PLACES = 3, BANDS = 5 };
  static const double at[PLACES] = {2, 5, 9}, none[PLACES], mhz[PLACES] = {0, 100, 100};
  static const double quantity[PLACES] = {0, CORE_QUANTITY_PHASE, CORE_QUANTITY_MODULATION};
  static const double nm[BANDS] = {660, 735, 785, 830, 900};
  static const core_sought sought[] = {{CORE_PROPERTY_HBO2}, {CORE_PROPERTY_HB}, {CORE_PROPERTY_A}};
  static const core_fit_design designs[] = {
      {29, 1, 0.9, 1.4, 0, NULL, 1, PLACES, at, NULL, NULL, 0, 1, {0}, true, none, none},
      {2, 1, 0.9, 1.4, 0, NULL, 1, PLACES, at, NULL, NULL, 0, 2, {0}, true, none, none},
      {2, 1, 0.9, 1.4, 0, NULL, 1, PLACES, at, NULL, NULL, 0, 1, {0}, true, mhz, quantity}};
  for (const core_choice *name = core_tissues; name->name != NULL; name++) {
    const unsigned i = name->id % 3;
    const core_fit_design design = designs[i];
    core_spectral_design spectral = {core_tissue_named(name->id), 3, sought, BANDS, nm};
    double *value = spectral.tissue.value;
    spectral.tissue.haemoglobin = 1 + name->id % 2;
    value[CORE_PROPERTY_VESSEL_RADIUS] = 0.02 * i;
    value[1 + name->id % CORE_PROPERTY_MELANIN] += 0.01;
    value[CORE_PROPERTY_A] = fmax(value[CORE_PROPERTY_A], 1);
    value[CORE_PROPERTY_B] = fmax(value[CORE_PROPERTY_B], 0.5);
    uint64_t sum = CHECKSUM_START;
    double values[BANDS * PLACES], errors[BANDS * PLACES], residuals[BANDS * PLACES] = {0};
    for (size_t k = 0; k < BANDS * PLACES; k++) {
      const size_t place = k % PLACES;
      core_medium medium = {0};
      sum = add_fault(sum, core_tissue_medium(&spectral.tissue, nm[k / PLACES], &medium));
      sum = add_numbers(sum, &medium, sizeof medium);
      take_readings(isa, design.model, &medium, design.mhz[place] > 0 ? design.mhz[place] : NAN,
                    design.quantity[place] > 0 ? (unsigned)design.quantity[place] : CORE_QUANTITY_R,
                    1, &at[place], &values[k]);
      errors[k] = 0.01 * values[k];
      values[k] *= 1 + 0.001 * (double)k;
    }
    core_spectral_result result;
    core_spectral *search;
    memset(&result, 0, sizeof result);
    core_fit *fit;
    sum = add_fault(sum, core_fit_create(&fit, isa, &design));
    sum = add_fault(sum, core_spectral_create(&search, &spectral, PLACES, design.scale));
    bool more = core_spectral_begin(search, fit, values, errors, &result, residuals);
    while (more) {
      more = core_spectral_step(search, &result, residuals);
    }
    sum = add_numbers(add_numbers(sum, &result, sizeof result), residuals, sizeof residuals);
    core_spectral_free(search);
    core_fit_free(fit);
    print_sum("spectra", name->name, sum);
  }
}

/* Prints a checksum of what is chosen for tolerances, for each quantity. */
static void print_choices(void) {
  static const core_medium media[] = {
      {0.05, 9.5, 0.9, 1.4}, {1e-4, 10, 0, 1.4}, {2, 1.25, -0.3, 0.8}, {0.1, 2, 0, 1.3, 2}};
  static const double tolerances[] = {0.3, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9};
  static const uint64_t counts[] = {1, 1000, 1000000};
  for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
    uint64_t sum = CHECKSUM_START;
    for (size_t i = 0; i < 4 * 6 * 3 * 2; i++) {
      const core_radii_range radii = {i % 7 == 0 ? 1e-4 : 0.05, i % 4 == 0 ? 1000 : 5};
      const core_choose_request request = {
          &media[i % 4],        1, 1, NAN, quantity->id, radii, counts[i / 24 % 3], i / 72 == 1,
          tolerances[i / 4 % 6]};
      core_candidate found[CORE_TRANSPORT_CANDIDATES];
      const double stored = core_choose_stored_error(&request);
      const size_t count = core_choose(&request, found);
      sum = add_numbers(sum, &stored, sizeof stored);
      for (size_t k = 0; k < count; k++) {
        const unsigned ids[] = {found[k].model, found[k].evaluator, found[k].looked_up,
                                found[k].meets};
        sum = add_numbers(checksum(sum, ids, sizeof ids), &found[k].numerical_tolerance,
                          offsetof(core_candidate, looked_up) -
                              offsetof(core_candidate, numerical_tolerance));
      }
    }
    print_sum("choices", quantity->name, sum);
  }
}

/* Prints checksums of faults of media and parameters at the ends of what is allowed and beyond, and of
 * what takes long. */
static void print_refusals(const core_isa *isa) {
  static const double numbers[] = {-1,   0,   5e-324, 1e-33, 1e-16, 1e-15, 1e-6, 1e-3,
                                   0.01, 0.1, 0.2,    0.5,   0.7,   0.8,   0.9,  0.95,
                                   0.96, 1,   1.3,    1.4,   2,     2.2,   2.3,  3,
                                   5,    10,  100,    1e3,   1001,  1e15,  2e15, 2e30};
  enum { NUMBERS = sizeof numbers / sizeof numbers[0] };
  uint64_t state = 1, sum = CHECKSUM_START, of_walks = CHECKSUM_START;
  for (unsigned i = 0; i < 60000; i++) {
    core_medium layer[2] = {{0.05, 9.5, 0.9, 1.4}, {0.1, 2, 0, 1.3}};
    core_parameters parameters = core_parameters_none();
    core_radii_range radii = {0, 0};
    double *const any[] = {
        &layer[0].sigma_a_per_mm, &layer[0].sigma_s_per_mm, &layer[0].g, &layer[0].eta,
        &layer[0].thickness_mm,   &layer[1].thickness_mm};
    for (size_t k = 0; k < sizeof any / sizeof any[0]; k++) {
      *any[k] = core_splitmix(&state) % 4 > 0 ? *any[k] : numbers[core_splitmix(&state) % NUMBERS];
    }
    for (const core_choice *one = core_parameter_list; one->name != NULL; one++) {
      const double value = numbers[core_splitmix(&state) % NUMBERS];
      parameters.value[one->id] = core_splitmix(&state) % 24 == 0 ? value : (double)NAN;
    }
    parameters.layer_count = 1 + i / 8 % 2;
    const unsigned model = (unsigned)(core_splitmix(&state) % 32), evaluator = 1 + i % 4;
    const core_fault fault =
        core_profile_check(model, 1 + i / 4 % 4, evaluator, layer, &parameters, &radii);
    sum = add_numbers(add_fault(sum, fault), &radii, sizeof radii);
    if (fault.field == NULL) {
      const bool costs[] = {core_prepares_slowly(model, evaluator, layer, &parameters),
                            core_has_to_solve(model, layer, &parameters),
                            core_worth_keeping(model, evaluator, &parameters)};
      sum = add_fault(checksum(sum, costs, sizeof costs),
                      core_paths_check(model, 1u << i % 23, layer, &parameters));
      core_profile profile;
      const bool is_due = i % 7 == 0 && !costs[0] && model != CORE_MODEL_GAUSSIANS;
      const core_fault made = is_due ? core_profile_prepare(&profile, isa, model, 1 + i / 4 % 4,
                                                            evaluator, layer, &parameters)
                                     : (core_fault){"", "", 0};
      if (made.field == NULL) {
        sum = add_numbers(sum, &profile.albedo, sizeof profile.albedo);
        core_profile_free(&profile);
      }
      sum = add_fault(sum, made);
    }
    core_mc_request request = {.edges = {1 + i % 3, 2, layer[0].eta, numbers[i % NUMBERS]}};
    of_walks = add_fault(of_walks, core_mc_request_parameters(&request, &parameters));
    if (core_layers_check(layer, parameters.layer_count).field == NULL) {
      core_mc_request_medium(&request, layer, parameters.layer_count);
      of_walks = add_fault(of_walks, core_mc_check(&request));
    }
  }
  print_sum("refusals", "profiles", sum);
  print_sum("refusals", "walks", of_walks);
}

/* Returns the usual number, or now and then one at the end of what something allows, or beyond. */
static double usual_or_end(uint64_t *state, double usual) {
  static const double ends[] = {-1,   0,   1e-6, 0.009, 0.01, 0.1,  0.25, 0.5,  0.7,  0.95, 1,
                                1.01, 1.4, 2.2,  2.3,   4,    5,    10,   300,  512,  1e3,  1e4,
                                1e5,  2e5, 1e9,  2e9,   1e12, 2e12, 1e14, 2e14, 1e30, 2e30, NAN};
  const uint64_t which = core_splitmix(state);
  return which % 12 > 0 ? usual : ends[which / 12 % (sizeof ends / sizeof ends[0])];
}

/* Prints checksums of faults of what is to be fitted, gathered and inverted, and of what fits cost. */
static void print_refused_searches(void) {
  enum { MOST = CORE_FIT_READINGS_MAX + 1, KINDS = 6, LAYERS = 3 };
  static const double usual[KINDS] = {2, 0, 0.4, 100, CORE_QUANTITY_PHASE, 650};
  static const size_t counts[] = {0, 1, 2, 3, 5, 12, 512, 513, 1024, MOST};
  static double of[KINDS][MOST];
  uint64_t state = 3, fits = CHECKSUM_START, layers = fits, spectra = fits, others = fits;
  for (unsigned i = 0; i < 8000; i++) {
    const uint64_t any = core_splitmix(&state);
    const size_t count = any % 4 > 0 ? 4 : counts[any / 4 % 10];
    const unsigned scale = any >> 6 & 31 ? 1 + i % 3 : (unsigned)any % 5;
    for (size_t kind = 0; kind < KINDS; kind++) {
      for (size_t k = 0; k < count; k++) {
        of[kind][k] =
            count > 12 && k != any % count ? usual[kind] : usual_or_end(&state, usual[kind]);
      }
    }
    core_parameters parameters = core_parameters_none();
    core_medium layer[LAYERS] = {{0.05, 9.5, 0.8, 1.4, 1}, {0.1, 2, 0, 1.3, 2}, {1, 1, 0.5, 1.4}};
    for (size_t k = 0; k < LAYERS; k++) {
      layer[k].g = usual_or_end(&state, layer[k].g);
      layer[k].eta = usual_or_end(&state, layer[k].eta);
      layer[k].sigma_s_per_mm = usual_or_end(&state, layer[k].sigma_s_per_mm);
      layer[k].thickness_mm = usual_or_end(&state, layer[k].thickness_mm);
    }
    parameters.value[CORE_PARAMETER_GAMMA] = i % 5 == 0 ? usual_or_end(&state, 1.5) : (double)NAN;
    const core_fit_design design = {.model = i % 2 ? CORE_MODEL_TRANSPORT : i / 2 % 33,
                                    .moments = 1,
                                    .g = layer[0].g,
                                    .eta = layer[0].eta,
                                    .thickness_mm = i % 8 > 0 ? 0 : layer[0].thickness_mm,
                                    .parameters = i % 3 ? &parameters : NULL,
                                    .axis = any >> 11 & 15 ? 1 + i / 4 % 2 : 3,
                                    .count = count,
                                    .at = of[0],
                                    .source_mm = of[1],
                                    .detector_mm = i % 8 < 4 ? of[2] : NULL,
                                    .detector_na = i % 5 ? 0 : usual_or_end(&state, 0.4),
                                    .scale = scale,
                                    .reference = layer[2],
                                    .of_spectra = any >> 15 & 1,
                                    .mhz = i % 7 > 4 ? of[3] : NULL,
                                    .quantity = i % 7 > 3 ? of[4] : NULL};
    const core_fault fault = core_fit_check(&design);
    fits = add_fault(fits, fault);
    if (fault.field == NULL) {
      const core_fit_cost cost = core_fit_cost_of(&design);
      const double costs[] = {cost.evaluations, cost.evaluation};
      fits = add_numbers(fits, costs, sizeof costs);
    }
    const core_layers_fit_request request = {
        scale, any >> 16 & (i % 8 == 0 ? 127u : i % LAYERS == 0 ? 7u : 63u),
        layer, 1 + i % LAYERS,
        count, of[0],
        of[1], of[2]};
    layers = add_fault(layers, core_layers_fit_check(&request));
    core_sought sought[LAYERS] = {{0}};
    core_tissue tissue = core_tissue_named(1 + i % 6);
    for (size_t k = 0; k < LAYERS; k++) {
      const core_choice *one = &core_properties[core_splitmix(&state) % 16];
      sought[k].property = any >> 24 & 15 ? one->id : (uint32_t)any % 40;
      sought[k].low = usual_or_end(&state, 0);
      sought[k].high = usual_or_end(&state, sought[k].low > 0 ? 10 : 0);
      tissue.value[1 + k] = usual_or_end(&state, tissue.value[1 + k]);
    }
    const core_spectral_design spectral = {tissue, 1 + i % 3, sought, count, of[5]};
    core_spectral *search;
    spectra = add_fault(spectra, core_spectral_create(&search, &spectral, 1 + i % 5, scale));
    core_spectral_free(search);
    double any_number[4]; /* one after the other: compilers differ in the order of arguments */
    for (size_t k = 0; k < 4; k++) {
      any_number[k] = usual_or_end(&state, k < 2 ? 1 + (double)k : k == 2 ? 1 : 1e-14);
    }
    const float power[] = {1e30f, (float)any_number[0], (float)any_number[1]};
    core_inverter inverter;
    const core_fault faults[] = {core_gather_check_points(count / 3 % 2, of[0], 3, power),
                                 core_gather_check_queries(count / 3, of[1]),
                                 core_inversion_check(any_number[2], any_number[3]),
                                 core_inverter_start(&inverter, design.model, 1, any >> 32 & 1,
                                                     i % 8 < 4, design.g, design.eta, 0.5)};
    for (size_t k = 0; k < sizeof faults / sizeof faults[0]; k++) {
      others = add_fault(others, faults[k]);
    }
    if (faults[3].field == NULL) {
      const double seen[] = {core_inverter_seen(&inverter, 0.3), inverter.ratio_least,
                             inverter.ratio_most};
      others = add_numbers(others, &inverter.medium, sizeof inverter.medium);
      others = add_numbers(others, seen, sizeof seen);
    }
  }
  print_sum("refusals", "fits", fits);
  print_sum("refusals", "layers", layers);
  print_sum("refusals", "spectra", spectra);
  print_sum("refusals", "others", others);
}

int main(int argc, char **argv) {
  const core_isa *isa = core_isa_select(argc < 2 ? "portable" : argv[1][0] == '-' ? NULL : argv[1]);
  if (isa == NULL) {
    fprintf(stderr, "bits: this machine cannot run %s\n", argv[1]);
    return NOT_HERE;
  }
  const char part = argc > 2 ? argv[2][0] : 'a'; /* all */
  static const unsigned varied[] = {CORE_MODEL_BETTER, CORE_MODEL_BURLEY, CORE_MODEL_TRANSPORT};
  for (size_t i = 0; strchr("ak", part) != NULL && i < sizeof varied / sizeof varied[0]; i++) {
    print_varying(isa, varied[i], CORE_EVALUATOR_F64);
    print_varying(isa, varied[i], CORE_EVALUATOR_F32);
  }
  for (const core_choice *model = core_models; strchr("akf", part) && model->name != NULL;
       model++) {
    const bool all_moments = model->id == CORE_MODEL_CLASSICAL || model->id == CORE_MODEL_BETTER;
    for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
      for (const core_choice *moments = core_moments_list; moments->name != NULL; moments++) {
        const bool one_kind = !all_moments || evaluator->id == CORE_EVALUATOR_LUT;
        const bool is_due =
            evaluator->id == CORE_EVALUATOR_F64 ||
            (part != 'f' && (evaluator->id == CORE_EVALUATOR_F32 || is_tabulated(model)));
        if (is_due && (!one_kind || moments->id == CORE_MOMENTS_EXACT)) {
          print_group(isa, model, evaluator, moments);
        }
      }
    }
    if (all_moments && part != 'f') {
      print_inversions(model);
    }
  }
  if (strchr("as", part) != NULL) {
    print_answers(isa);
  }
  if (part == 'l') {
    print_layers(isa);
  }
  if (strchr("ao", part) != NULL) {
    print_grids(isa);
    print_walks(isa);
    print_gathered(isa);
    print_fits(isa);
    print_spectra(isa);
    print_choices();
    print_refusals(isa);
    print_refused_searches();
  }
  return EXIT_SUCCESS;
}
