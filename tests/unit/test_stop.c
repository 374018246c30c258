/* What prepares layers looks at `stop` often: counted in calls of what takes long, not in time. */
#include <stdatomic.h>

#include "core/kernels.h"
#include "core/solver/dense.h"
#include "core/solver/exitance.h"
#include "core/solver/level.h"
#include "tests/unit/unit.h"

enum { BETWEEN = 100 }; /* calls, of at most some milliseconds each */

static size_t looks, looks_most, works, works_most;

bool real_stops(const atomic_bool *stop) __asm__("__real_solver_stops");
bool wrap_stops(const atomic_bool *stop) __asm__("__wrap_solver_stops");
bool wrap_stops(const atomic_bool *stop) {
  looks += stop != NULL;
  works = stop != NULL ? 0 : works;
  return real_stops(stop) || (stop != NULL && looks >= looks_most);
}

static void count_work(void) {
  works_most = ++works > works_most ? works : works_most;
}

typedef bool congruence(const dense *to, const dense *a, const dense *b, const dense *spare);
congruence real_congruence __asm__("__real_solver_dense_congruence");
congruence wrap_congruence __asm__("__wrap_solver_dense_congruence");
bool wrap_congruence(const dense *to, const dense *a, const dense *b, const dense *spare) {
  count_work();
  return real_congruence(to, a, b, spare);
}

typedef double exitance_value(const exitance_series *at, const exitance_grid *of, double r,
                              double *size);
exitance_value real_exitance __asm__("__real_solver_exitance_at");
exitance_value wrap_exitance __asm__("__wrap_solver_exitance_at");
double wrap_exitance(const exitance_series *at, const exitance_grid *of, double r, double *size) {
  count_work();
  return real_exitance(at, of, r, size);
}

static core_fault prepare_until(size_t look) {
  static const core_medium layer[] = {{0.1, 10, 0.8, 1.4, 1}, {0.2, 10, 0.8, 1.4, 1}};
  const atomic_bool stop = false;
  core_profile profile;
  core_parameters parameters = core_parameters_none();
  parameters.layer_count = 2;
  parameters.value[CORE_PARAMETER_TOLERANCE] = 1;
  looks = works = works_most = 0;
  looks_most = look;
  const core_fault fault =
      core_profile_prepare_until(&profile, core_isa_select(NULL), CORE_MODEL_TRANSPORT,
                                 CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, layer, &parameters, &stop);
  if (fault.field == NULL) {
    core_profile_free(&profile);
  }
  assert_true(works_most < BETWEEN);
  return fault;
}

UNIT_TEST(layers_that_nobody_wants_stop_soon) {
  unit_accept(prepare_until(SIZE_MAX));
  const size_t all = looks;
  assert_true(all > 1000);
  for (size_t part = 1; part <= 8; part++) {
    unit_assert_fault(prepare_until(all * part / 8), CORE_FIELD_STOPPED, 0);
  }
}
