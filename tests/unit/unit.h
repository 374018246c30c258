/* unit: the parts that all test programs in C share: main(), cmocka and the headers that it needs,
 * random numbers from a printed seed, and an assertion on faults. */
#ifndef DIPOLED_TESTS_UNIT_H
#define DIPOLED_TESTS_UNIT_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/core.h"

/* UNIT_TEST(name) { ... } defines a test and registers it. main(), in unit.c, runs the tests of the
 * program in the order in which they stand in the file. */
#define UNIT_TEST(name)                                                                            \
  static void name(void **state);                                                                  \
  __attribute__((constructor)) static void register_##name(void) {                                 \
    unit_register(#name, name, __LINE__);                                                          \
  }                                                                                                \
  static void name(__attribute__((unused)) void **state)

/* UNIT_SETUP(name) { ... } runs once before the tests of the program, UNIT_TEARDOWN(name) { ... }
 * once after them. A program has at most one of each. */
#define UNIT_SETUP(name) UNIT_ASIDE(name, unit_setup)
#define UNIT_TEARDOWN(name) UNIT_ASIDE(name, unit_teardown)
#define UNIT_ASIDE(name, pointer)                                                                  \
  static void name(void);                                                                          \
  __attribute__((constructor)) static void register_##name(void) {                                 \
    pointer = name;                                                                                \
  }                                                                                                \
  static void name(void)

/* Only the macros of this header use these names. */
void unit_register(const char *name, CMUnitTestFunction test, int line);
extern void (*unit_setup)(void), (*unit_teardown)(void);

/* The arguments of the program. The list ends with NULL. */
extern char **unit_arguments;

enum { UNIT_ROWS_MAX = 100 }; /* a bound for loops over lists that end with an empty entry */

/* Returns and prints the seed of this run: $TEST_SEED, or a fixed one. With the printed
 * seed a failure can be repeated. */
uint64_t unit_seed(void);

/* Returns whether the tests have their long form, with more media: $UNIT_LONG is set. */
bool unit_is_long(void);

/* Returns the next 64 random bits (core/splitmix.h). */
uint64_t unit_random(uint64_t *state);
double unit_random_between(uint64_t *state, double low, double high);
double unit_random_log(uint64_t *state, double low, double high); /* equal chance per decade */
size_t unit_random_below(uint64_t *state, size_t limit);
void unit_random_bytes(uint64_t *state, void *to, size_t bytes);

/* Fails with a message, of a format and what it prints, if something is wrong. */
#define UNIT_FAIL_IF(wrong, ...)                                                                   \
  do {                                                                                             \
    if (wrong) {                                                                                   \
      fail_msg(__VA_ARGS__);                                                                       \
    }                                                                                              \
  } while (0)

/* Checks that there is no fault. */
void unit_accept(core_fault fault);

/* Checks that a fault names this field, says what is allowed, and has this index. field: NULL if
 * there must be no fault. */
void unit_assert_fault(core_fault fault, const char *field, size_t index);

/* Returns the medium as a model needs it: a slab gets a thickness of 3 mean free paths. */
core_medium unit_medium(unsigned model, const core_medium *medium);

/* Prepares a profile with exact moments by the best instruction set, which the caller frees. The test
 * fails if the medium is refused. parameters: NULL for none. */
core_profile unit_profile(unsigned model, unsigned evaluator, const core_medium *medium,
                          const core_parameters *parameters);

/* Returns an elementwise quantity of a profile at r mm, in the precision of its evaluator. */
double unit_value_at(const core_profile *profile, enum core_quantity quantity, double r_mm);

/* Reads a whole file as text, which the caller frees. Returns NULL if there is no such file. */
char *unit_read_file(const char *path);

#endif
