/* bits [ISA]: evaluates a fixed, broad set of requests and prints a checksum of the bits of every
 * group of answers. Two machines, compilers or instruction sets that print the same gave the same
 * bits; tests/run-bits.sh compares them.
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/core.h"

enum { MEDIA = 61, RADII = 257 };

/* FNV-1a, 64 bits. */
static uint64_t checksum(uint64_t sum, const void *bytes, size_t n) {
  const unsigned char *at = bytes;
  for (size_t i = 0; i < n; i++) {
    sum = (sum ^ at[i]) * UINT64_C(0x100000001b3);
  }
  return sum;
}

static const uint64_t CHECKSUM_START = UINT64_C(0xcbf29ce484222325);

/* splitmix64: the same numbers everywhere. */
static uint64_t random_bits(uint64_t *state) {
  uint64_t z = (*state += UINT64_C(0x9e3779b97f4a7c15));
  z = (z ^ (z >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
  z = (z ^ (z >> 27)) * UINT64_C(0x94d049bb133111eb);
  return z ^ (z >> 31);
}

static double uniform(uint64_t *state) {
  return (double)(random_bits(state) >> 11) * 0x1p-53;
}

/* A power of two with a random mantissa: spread over many magnitudes without calling pow(). */
static double spread(uint64_t *state, int least_exponent, int most_exponent) {
  const uint64_t biased = (uint64_t)(1023 + least_exponent) +
                          random_bits(state) % (uint64_t)(most_exponent - least_exponent + 1);
  const uint64_t bits = (biased << 52) | (random_bits(state) >> 12);
  double value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

static core_medium random_medium(uint64_t *state) {
  core_medium medium;
  medium.sigma_s_per_mm = spread(state, -20, 20);
  medium.sigma_a_per_mm = random_bits(state) % 8 == 0 ? 0 : spread(state, -30, 20);
  medium.g = 1.9 * uniform(state) - 0.95;
  medium.eta = 0.5 + 1.6 * uniform(state);
  return medium;
}

/* One profile's answers, added to the checksum. */
static uint64_t add_quantity(uint64_t sum, const core_profile *profile, unsigned quantity,
                             uint64_t *state) {
  double r[RADII];
  double out[RADII];
  float r32[RADII];
  float out32[RADII];
  for (int i = 0; i < RADII; i++) {
    r[i] = i == 0 ? 0 : spread(state, -40, 30);
    r32[i] = (float)r[i];
  }
  if (profile->evaluator == CORE_EVALUATOR_F32) {
    core_eval_f32(profile, quantity, RADII, r32, out32);
    return checksum(sum, out32, sizeof out32);
  }
  core_eval_f64(profile, quantity, RADII, r, out);
  return checksum(sum, out, sizeof out);
}

static uint64_t add_samples(uint64_t sum, const core_profile *profile, uint64_t *state) {
  double u[RADII];
  double r[RADII];
  float u32[RADII];
  float r32[RADII];
  for (int i = 0; i < RADII; i++) {
    u[i] = uniform(state);
    u32[i] = (float)u[i];
  }
  if (profile->evaluator == CORE_EVALUATOR_F32) {
    core_sample_f32(profile, RADII, u32, r32);
    return checksum(sum, r32, sizeof r32);
  }
  core_sample_f64(profile, RADII, u, r);
  return checksum(sum, r, sizeof r);
}

/* Every medium under one model, evaluator and kind of moments; quantity 0: samples. */
static void print_group(const core_isa *isa, const core_choice *model, const core_choice *evaluator,
                        const core_choice *moments, const core_choice *quantity) {
  uint64_t state = 2012;
  uint64_t sum = CHECKSUM_START;
  for (int i = 0; i < MEDIA; i++) {
    const core_medium medium = random_medium(&state);
    core_profile profile;
    const core_fault fault =
        core_profile_prepare(&profile, isa, model->id, moments->id, evaluator->id, &medium);
    if (fault.field != NULL) {
      fprintf(stderr, "bits: %s: %s\n", fault.field, fault.allowed);
      exit(EXIT_FAILURE);
    }
    sum = checksum(sum, &profile.albedo, sizeof profile.albedo);
    sum = quantity != NULL ? add_quantity(sum, &profile, quantity->id, &state)
                           : add_samples(sum, &profile, &state);
  }
  printf("%s %s %s %s %016" PRIx64 "\n", model->name, evaluator->name, moments->name,
         quantity != NULL ? quantity->name : "sample", sum);
}

static void print_grids(void) {
  uint64_t state = 1905;
  uint64_t sum = CHECKSUM_START;
  for (int i = 0; i < MEDIA; i++) {
    double r[RADII];
    const double start = spread(&state, -30, 10);
    const core_grid grid = {i % 2 ? CORE_SPACING_LINEAR : CORE_SPACING_LOGARITHMIC, RADII, start,
                            start * spread(&state, 0, 40)};
    core_grid_radii_f64(&grid, 0, RADII, r);
    sum = checksum(sum, r, sizeof r);
  }
  printf("grids %016" PRIx64 "\n", sum);
}

static void print_inversions(const core_choice *model) {
  uint64_t state = 2001;
  uint64_t sum = CHECKSUM_START;
  for (int i = 0; i < MEDIA; i++) {
    const double albedo = uniform(&state);
    const core_inversion inversion =
        core_invert_albedo(model->id, CORE_MOMENTS_EXACT, albedo, spread(&state, -10, 10), 1.3);
    sum = checksum(sum, &inversion.medium, sizeof inversion.medium);
  }
  printf("%s inversions %016" PRIx64 "\n", model->name, sum);
}

int main(int argc, char **argv) {
  const core_isa *isa = core_isa_select(argc > 1 ? argv[1] : "portable");
  if (isa == NULL) {
    fprintf(stderr, "bits: this machine cannot run %s\n", argv[1]);
    return EXIT_FAILURE;
  }
  for (const core_choice *model = core_models; model->name != NULL; model++) {
    for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
      for (const core_choice *moments = core_moments_list; moments->name != NULL; moments++) {
        for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
          if (core_quantity_elementwise(quantity->id)) {
            print_group(isa, model, evaluator, moments, quantity);
          }
        }
        print_group(isa, model, evaluator, moments, NULL);
      }
    }
    print_inversions(model);
  }
  print_grids();
  return EXIT_SUCCESS;
}
