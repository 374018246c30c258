/* Sums over all points. */
#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "core/gather/points.h"

enum { BLOCK = 512 };

struct core_gather_sum {
  const core_isa *isa;
  size_t channels;
  double tolerance;
  core_profile profile[CORE_GATHER_CHANNELS_MAX]; /* copies that share the caller's memory */
};

core_fault core_gather_sum_prepare(core_gather_sum **sum, const core_isa *isa, size_t channels,
                                   const core_profile *const *profiles, double tolerance) {
  assert(channels >= 1 && channels <= CORE_GATHER_CHANNELS_MAX);
  *sum = NULL;
  if (!(tolerance <= 0 && tolerance >= 0) &&
      !(tolerance >= CORE_GATHER_TOLERANCE_MIN && tolerance <= CORE_GATHER_TOLERANCE_MAX)) {
    return (core_fault){"tolerance", "0, or 1e-9 to 0.5", 0};
  }
  core_gather_sum *made = malloc(sizeof *made);
  if (made == NULL) {
    return (core_fault){CORE_FIELD_MEMORY, "less than what is left: try again", 0};
  }
  *made = (core_gather_sum){.isa = isa, .channels = channels, .tolerance = tolerance};
  for (size_t c = 0; c < channels; c++) {
    assert(profiles[c]->evaluator == profiles[0]->evaluator);
    made->profile[c] = *profiles[c];
  }
  *sum = made;
  return (core_fault){0};
}

void core_gather_sum_free(core_gather_sum *sum) {
  free(sum);
}

size_t core_gather_sum_bytes(const core_gather_sum *sum) {
  return sizeof *sum;
}

double core_gather_query_cost(const core_gather_sum *sum, const core_gather_points *points) {
  double cost = 0;
  for (size_t c = 0; c < sum->channels; c++) {
    cost += core_radius_cost(&sum->profile[c], CORE_QUANTITY_R);
  }
  return cost * (double)points->n;
}

struct core_gather_scratch {
  double r[BLOCK];
  double R[BLOCK];
  float narrow_r[BLOCK];
  float narrow_R[BLOCK];
};

core_gather_scratch *core_gather_scratch_create(const core_gather_points *points) {
  assert(points->built);
  return calloc(1, sizeof(core_gather_scratch));
}

void core_gather_scratch_free(core_gather_scratch *scratch) {
  free(scratch);
}

size_t core_gather_scratch_bytes(const core_gather_points *points) {
  (void)points;
  return sizeof(core_gather_scratch);
}

void core_gather_order(const core_gather_points *points, size_t n, const double *xyz,
                       uint32_t *order) {
  (void)points;
  (void)xyz;
  for (size_t i = 0; i < n; i++) {
    order[i] = (uint32_t)i;
  }
}

/* Evaluates R at the radii of the scratch. */
static void evaluate(const core_profile *profile, core_gather_scratch *s, size_t n) {
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    core_eval_f64(profile, CORE_QUANTITY_R, n, s->r, s->R);
    return;
  }
  for (size_t i = 0; i < n; i++) {
    s->narrow_r[i] = (float)s->r[i];
  }
  core_eval_f32(profile, CORE_QUANTITY_R, n, s->narrow_r, s->narrow_R);
  for (size_t i = 0; i < n; i++) {
    s->R[i] = (double)s->narrow_R[i];
  }
}

void core_gather(const core_gather_sum *sum, const core_gather_points *points,
                 core_gather_scratch *scratch, size_t n, const uint32_t *order, const double *xyz,
                 double *M, float *bound, core_gather_visits *visits) {
  assert(points->built && points->channels == sum->channels);
  for (size_t i = 0; i < n; i++) {
    const size_t q = order != NULL ? order[i] : i;
    double total[CORE_GATHER_CHANNELS_MAX] = {0};
    for (size_t done = 0; done < points->n; done += BLOCK) {
      const size_t count = points->n - done < BLOCK ? points->n - done : BLOCK;
      for (size_t k = 0; k < count; k++) {
        const double x = xyz[3 * q] - points->at[0][done + k];
        const double y = xyz[3 * q + 1] - points->at[1][done + k];
        const double z = xyz[3 * q + 2] - points->at[2][done + k];
        scratch->r[k] = sqrt(x * x + y * y + z * z);
      }
      for (size_t c = 0; c < sum->channels; c++) {
        evaluate(&sum->profile[c], scratch, count);
        double part = 0;
        for (size_t k = 0; k < count; k++) {
          const double power = (double)points->power[c][done + k];
          part += power > 0 ? power * scratch->R[k] : 0;
        }
        total[c] += part;
      }
    }
    for (size_t c = 0; c < sum->channels; c++) {
      M[q * sum->channels + c] = total[c];
      if (bound != NULL) {
        bound[q * sum->channels + c] = 0;
      }
    }
  }
  visits->queries += n;
  visits->points += (uint64_t)n * points->n;
}

double core_gather_error(const core_gather_sum *sum, const core_gather_points *points,
                         size_t channel, size_t n, const double *xyz) {
  (void)points;
  (void)n;
  (void)xyz;
  const core_profile *profile = &sum->profile[channel];
  return core_profile_errors(profile, CORE_QUANTITY_R, (core_radii_range){0, 0}).numerical;
}
