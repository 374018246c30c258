/* The lists from which requests choose: what fits the wire. test_permanent_ids has the ids that must never
 * change. */
#include "tests/unit/unit.h"

static const core_choice *const lists[] = {
    core_models,         core_evaluators, core_moments_list, core_quantities, core_spacings,
    core_parameter_list, core_notes,      core_draws,        core_lengths,    core_phases,
};
enum { LISTS = sizeof lists / sizeof lists[0] };

/* On the wire, an id has 32 bits and is not 0, a name has 32 bytes, and its explanation 96. */
UNIT_TEST(entries_fit_the_wire) {
  for (size_t i = 0; i < LISTS; i++) {
    for (const core_choice *entry = lists[i]; entry->name != NULL; entry++) {
      assert_in_range(entry->id, 1, 0x7fffffff);
      assert_in_range(strlen(entry->name), 1, 32);
      assert_non_null(entry->about);
      assert_in_range(strlen(entry->about), 1, 96);
    }
  }
}

static void assert_separate_bits(const core_choice *list) {
  unsigned seen = 0;
  for (const core_choice *entry = list; entry->name != NULL; entry++) {
    assert_int_equal(entry->id & (entry->id - 1), 0);
    assert_int_equal(seen & entry->id, 0);
    seen |= entry->id;
  }
}

UNIT_TEST(quantities_and_notes_are_separate_bits) {
  assert_separate_bits(core_quantities);
  assert_separate_bits(core_notes);
}

/* Every id of a parameter is below CORE_PARAMETERS_END, because it indexes core_parameters and the
 * bits of a model's parameters. */
UNIT_TEST(parameters_are_few) {
  const core_parameters none = core_parameters_none();
  assert_true(CORE_PARAMETERS_END <= 32);
  for (const core_choice *entry = core_parameter_list; entry->name != NULL; entry++) {
    assert_in_range(entry->id, 1, CORE_PARAMETERS_END - 1);
    assert_true(none.value[entry->id] != none.value[entry->id]);
  }
}
