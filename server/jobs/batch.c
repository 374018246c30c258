#include "server/jobs/batch.h"

#include <string.h>

_Static_assert(BATCH_PIECES <= 1 << (STATS_BATCH_SIZES - 1), "the last size is for all others");

static size_t value_bytes(const struct batch_group *group) {
  return core_evaluator_bytes(group->slot->profile.evaluator);
}

static void evaluate(struct batch_group *group, struct stats *stats) {
  double values[BATCH_RADII];
  const core_profile *profile = &group->slot->profile;
  const size_t bytes_each = value_bytes(group);
  if (bytes_each == sizeof(float)) {
    core_eval_f32(profile, group->quantity, group->radius_count,
                  (const float *)(const void *)group->radii, (float *)(void *)values);
  } else {
    core_eval_f64(profile, group->quantity, group->radius_count, group->radii, values);
  }
  const uint8_t *from = (const uint8_t *)values;
  for (size_t i = 0; i < group->piece_count; i++) {
    const size_t bytes = group->pieces[i].count * bytes_each;
    memcpy(group->pieces[i].to, from, bytes);
    from += bytes;
  }
  stats_count_batch(stats, group->piece_count);
  stats_add(stats, STATS_BATCHED_REQUESTS, group->piece_count);
  group->radius_count = 0;
  group->piece_count = 0;
}

/* Evaluates a group and makes it free for another profile. */
static void clear(struct batch_group *group, struct stats *stats) {
  if (group->slot != NULL) {
    evaluate(group, stats);
    group->slot->pins--;
    group->slot = NULL;
  }
}

static struct batch_group *find(struct batch *batch, struct stats *stats,
                                struct profiles_slot *slot, enum core_quantity quantity) {
  for (size_t i = 0; i < BATCH_GROUPS; i++) {
    if (batch->groups[i].slot == slot && batch->groups[i].quantity == quantity) {
      return &batch->groups[i];
    }
  }
  struct batch_group *group = &batch->groups[batch->next];
  batch->next = (batch->next + 1) % BATCH_GROUPS;
  clear(group, stats);
  group->slot = slot;
  group->quantity = quantity;
  slot->pins++;
  return group;
}

bool batch_take(struct batch *batch, struct stats *stats, struct profiles_place place,
                enum core_quantity quantity, size_t n, const void *r, void *to) {
  if (quantity == CORE_QUANTITY_S || profiles_at(place) == NULL) {
    return false;
  }
  struct batch_group *group = find(batch, stats, place.slot, quantity);
  if (group->piece_count == BATCH_PIECES || group->radius_count + n > BATCH_RADII) {
    evaluate(group, stats);
  }
  const size_t bytes = value_bytes(group);
  memcpy((uint8_t *)group->radii + group->radius_count * bytes, r, n * bytes);
  group->radius_count += n;
  group->pieces[group->piece_count++] = (struct batch_piece){to, (uint32_t)n};
  return true;
}

void batch_finish(struct batch *batch, struct stats *stats) {
  for (size_t i = 0; i < BATCH_GROUPS; i++) {
    clear(&batch->groups[i], stats);
  }
}
