#include "tests/unit/unit.h"

#include <math.h>
#include <time.h>

#include "core/splitmix.h"

enum { TESTS_MAX = 64 };

/* The tests, sorted by their lines in the file. The entries behind the last test have no name, and
 * cmocka does not run them. */
static struct CMUnitTest tests[TESTS_MAX];
static int lines[TESTS_MAX];
static size_t test_count;

void (*unit_setup)(void), (*unit_teardown)(void);
char **unit_arguments;

/* A test that takes longer says so: in seconds of a processor, which depend little on what else the
 * machine does. */
#define LONG_S 0.5

static double processor_s(void) {
  return (double)clock() / CLOCKS_PER_SEC;
}

static double began_s;

static int begin(void **state) {
  (void)state;
  began_s = processor_s();
  return 0;
}

static int finish(void **state) {
  (void)state;
  const double took_s = processor_s() - began_s;
  if (took_s >= LONG_S) {
    printf("%.1f s of a processor\n", took_s);
  }
  return 0;
}

void unit_register(const char *name, CMUnitTestFunction test, int line) {
  if (test_count == TESTS_MAX) {
    abort();
  }
  size_t at = test_count++;
  for (; at > 0 && lines[at - 1] > line; at--) {
    tests[at] = tests[at - 1];
    lines[at] = lines[at - 1];
  }
  tests[at] = (struct CMUnitTest){
      .name = name, .test_func = test, .setup_func = begin, .teardown_func = finish};
  lines[at] = line;
}

static int group_setup(void **state) {
  (void)state;
  if (unit_setup != NULL) {
    unit_setup();
  }
  return 0;
}

static int group_teardown(void **state) {
  (void)state;
  if (unit_teardown != NULL) {
    unit_teardown();
  }
  return 0;
}

int main(int argc, char **argv) {
  unit_arguments = argv + (argc > 0);
  return cmocka_run_group_tests(tests, group_setup, group_teardown);
}

uint64_t unit_seed(void) {
  const char *chosen = getenv("TEST_SEED");
  const uint64_t seed = chosen != NULL ? strtoull(chosen, NULL, 0) : 20120101;
  printf("seed %llu (TEST_SEED chooses another)\n", (unsigned long long)seed);
  return seed;
}

bool unit_is_long(void) {
  return getenv("UNIT_LONG") != NULL;
}

uint64_t unit_random(uint64_t *state) {
  return core_splitmix(state);
}

double unit_random_between(uint64_t *state, double low, double high) {
  return low + (high - low) * (core_splitmix_f64(state));
}

double unit_random_log(uint64_t *state, double low, double high) {
  return fmin(high, fmax(low, exp(unit_random_between(state, log(low), log(high)))));
}

size_t unit_random_below(uint64_t *state, size_t limit) {
  return (size_t)(unit_random(state) % limit);
}

void unit_random_bytes(uint64_t *state, void *to, size_t bytes) {
  unsigned char *at = to;
  for (size_t i = 0; i < bytes; i++) {
    at[i] = (unsigned char)unit_random(state);
  }
}

void unit_accept(core_fault fault) {
  UNIT_FAIL_IF(fault.field != NULL, "unexpected fault: %s, allowed: %s", fault.field,
               fault.allowed);
}

void unit_assert_fault(core_fault fault, const char *field, size_t index) {
  if (field == NULL) {
    unit_accept(fault);
    return;
  }
  assert_non_null(fault.field);
  assert_string_equal(fault.field, field);
  assert_non_null(fault.allowed);
  assert_true(strlen(fault.allowed) > 0);
  assert_int_equal(fault.index, index);
}

core_medium unit_medium(unsigned model, const core_medium *medium) {
  core_medium needed = *medium;
  const core_fault fault =
      core_profile_check(model, CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, medium, NULL, NULL);
  if (fault.field != NULL && strcmp(fault.field, "thickness") == 0) {
    const double sigma_s_prime = medium->sigma_s_per_mm * (1 - medium->g);
    needed.thickness_mm = 3 / (medium->sigma_a_per_mm + sigma_s_prime);
  }
  return needed;
}

core_profile unit_profile(unsigned model, unsigned evaluator, const core_medium *medium,
                          const core_parameters *parameters) {
  core_profile profile;
  unit_accept(core_profile_prepare(&profile, core_isa_select(NULL), model, CORE_MOMENTS_EXACT,
                                   evaluator, medium, parameters));
  return profile;
}

double unit_value_at(const core_profile *profile, enum core_quantity quantity, double r_mm) {
  if (profile->evaluator == CORE_EVALUATOR_F64) {
    double out;
    core_eval_f64(profile, quantity, 1, &r_mm, &out);
    return out;
  }
  const float single = (float)r_mm;
  float out;
  core_eval_f32(profile, quantity, 1, &single, &out);
  return (double)out;
}

char *unit_read_file(const char *path) {
  FILE *file = fopen(path, "rb");
  if (file == NULL) {
    return NULL;
  }
  assert_int_equal(fseek(file, 0, SEEK_END), 0);
  const long bytes = ftell(file);
  assert_true(bytes >= 0);
  rewind(file);
  char *text = malloc((size_t)bytes + 1);
  assert_non_null(text);
  text[fread(text, 1, (size_t)bytes, file)] = '\0';
  fclose(file);
  return text;
}
