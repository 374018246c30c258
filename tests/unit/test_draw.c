/* Numbers that a rule makes: known values, independence of slices, and the range (0, 1). Invalid
 * rules and lists are in tests/e2e/wrong.txt. */
#include "core/draw.h"

#include <float.h>
#include <math.h>

#include "tests/unit/unit.h"

enum { COUNT = 1000 };

/* The outputs of Vigna's splitmix64.c for the seeds 1 and 1234567. */
static const struct {
  uint64_t seed;
  uint64_t outputs[5];
} known[] = {
    {1,
     {UINT64_C(10451216379200822465), UINT64_C(13757245211066428519),
      UINT64_C(17911839290282890590), UINT64_C(8196980753821780235),
      UINT64_C(8195237237126968761)}},
    {1234567,
     {UINT64_C(6457827717110365317), UINT64_C(3203168211198807973), UINT64_C(9817491932198370423),
      UINT64_C(4593380528125082431), UINT64_C(16408922859458223821)}},
};

UNIT_TEST(random_numbers_are_the_published_ones) {
  for (size_t k = 0; k < sizeof known / sizeof known[0]; k++) {
    const core_draw draw = {CORE_DRAW_RANDOM, 5, 0, known[k].seed};
    double f64[5];
    float f32[5];
    core_draw_f64(&draw, 0, 5, f64);
    core_draw_f32(&draw, 0, 5, f32);
    for (size_t i = 0; i < 5; i++) {
      const uint64_t z = known[k].outputs[i];
      assert_true(f64[i] == ldexp((double)(z >> 12) + 0.5, -52));
      assert_true(f32[i] == ldexpf((float)(z >> 41) + 0.5f, -23));
      assert_true(fabs(f64[i] - ldexp((double)z, -64)) <= 0x1p-52);
    }
  }
}

static core_draw any_draw(uint64_t *random, enum core_draw_rule rule) {
  return (core_draw){
      .rule = rule,
      .count = 1 + unit_random(random) % (unit_random(random) % 2 ? 100 : CORE_DRAW_COUNT_MAX),
      .first = rule == CORE_DRAW_RANDOM ? unit_random(random) % CORE_DRAW_COUNT_MAX : 0,
      .seed = rule == CORE_DRAW_REGULAR ? 0 : unit_random(random),
  };
}

/* A number has the same bits wherever the array is cut into slices. */
UNIT_TEST(numbers_do_not_depend_on_slices) {
  uint64_t random = unit_seed();
  for (int round = 0; round < 300; round++) {
    const core_draw draw = any_draw(&random, 2 + (unsigned)round % 3);
    const size_t n = draw.count < COUNT ? (size_t)draw.count : COUNT;
    const uint64_t begin = unit_random(&random) % (draw.count - n + 1);
    double all[COUNT], one;
    float all_f32[COUNT], one_f32;
    unit_accept(core_draw_check(&draw));
    core_draw_f64(&draw, begin, n, all);
    core_draw_f32(&draw, begin, n, all_f32);
    for (size_t i = 0; i < n; i++) {
      core_draw_f64(&draw, begin + i, 1, &one);
      core_draw_f32(&draw, begin + i, 1, &one_f32);
      assert_true(one == all[i] && one_f32 == all_f32[i]);
      assert_true(one > 0 && one < 1 && one_f32 > 0 && one_f32 < 1);
    }
  }
}

/* Draws with increasing `first` give the pieces of one sequence. */
UNIT_TEST(a_sequence_can_be_had_in_pieces) {
  const core_draw whole = {CORE_DRAW_RANDOM, COUNT, 0, 7};
  const core_draw later = {CORE_DRAW_RANDOM, COUNT - 300, 300, 7};
  double all[COUNT], rest[COUNT];
  core_draw_f64(&whole, 0, COUNT, all);
  core_draw_f64(&later, 0, COUNT - 300, rest);
  assert_memory_equal(rest, all + 300, (COUNT - 300) * sizeof *rest);
}

UNIT_TEST(every_stratum_has_its_number) {
  for (uint64_t seed = 0; seed < 20; seed++) {
    const core_draw draw = {CORE_DRAW_STRATIFIED, COUNT, 0, seed};
    double u[COUNT];
    core_draw_f64(&draw, 0, COUNT, u);
    for (size_t i = 0; i < COUNT; i++) {
      assert_true(u[i] >= (double)i / COUNT && u[i] <= (double)(i + 1) / COUNT);
    }
  }
  const core_draw regular = {CORE_DRAW_REGULAR, 4, 0, 0};
  const double middles[4] = {0.125, 0.375, 0.625, 0.875};
  double u[4];
  core_draw_f64(&regular, 0, 4, u);
  assert_memory_equal(u, middles, sizeof u);
}

/* With this many numbers, the last ones would round to 1. */
UNIT_TEST(no_number_is_1) {
  const core_draw many = {CORE_DRAW_REGULAR, CORE_DRAW_COUNT_MAX, 0, 0};
  double u;
  float u_f32;
  core_draw_f64(&many, many.count - 1, 1, &u);
  core_draw_f32(&many, many.count - 1, 1, &u_f32);
  assert_true(u < 1 && u > 1 - 1e-15);
  assert_true(u_f32 == 1 - FLT_EPSILON / 2);
}
