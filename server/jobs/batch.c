#include "server/jobs/batch.h"

#include <string.h>

_Static_assert(BATCH_PIECES <= 1 << (STATS_BATCH_SIZES - 1), "the last size is for all others");

static size_t value_bytes(const struct batch_group *group) {
  return core_evaluator_bytes(group->profile.evaluator);
}

static void evaluate(struct batch_group *group, struct stats *stats) {
  double values[BATCH_RADII];
  if (group->piece_count == 0) {
    return;
  }
  if (value_bytes(group) == sizeof(float)) {
    core_eval_f32(&group->profile, group->quantity, group->radius_count,
                  (const float *)(const void *)group->radii, (float *)(void *)values);
  } else {
    core_eval_f64(&group->profile, group->quantity, group->radius_count, group->radii, values);
  }
  const uint8_t *from = (const uint8_t *)values;
  for (size_t i = 0; i < group->piece_count; i++) {
    const size_t bytes = group->pieces[i].count * value_bytes(group);
    memcpy(group->pieces[i].to, from, bytes);
    from += bytes;
  }
  stats_count_batch(stats, group->piece_count);
  stats_add(stats, STATS_BATCHED_REQUESTS, group->piece_count);
  group->radius_count = 0;
  group->piece_count = 0;
}

/* Empties a group and makes it ready for another profile. */
static void clear(struct batch_group *group, struct stats *stats) {
  evaluate(group, stats);
  if (group->entry != NULL) {
    cache_release(group->entry);
    group->entry = NULL;
  }
  group->key.model = 0; /* which no profile has */
}

static bool is_for(const struct batch_group *group, const struct profiles_order *order,
                   enum core_quantity quantity) {
  return group->quantity == quantity && cache_key_equal(&group->key, &order->key);
}

static struct batch_group *find(struct batch *batch, struct stats *stats,
                                const struct profiles_order *order, enum core_quantity quantity) {
  for (size_t i = 0; i < BATCH_GROUPS; i++) {
    if (is_for(&batch->groups[i], order, quantity)) {
      return &batch->groups[i];
    }
  }
  struct batch_group *group = &batch->groups[batch->next];
  batch->next = (batch->next + 1) % BATCH_GROUPS;
  clear(group, stats);
  group->key = order->key;
  group->quantity = quantity;
  group->profile = order->profile;
  group->entry = order->entry;
  if (group->entry != NULL) {
    cache_hold(group->entry);
  }
  return group;
}

bool batch_take(struct batch *batch, struct stats *stats, const struct profiles_order *order,
                enum core_quantity quantity, size_t n, const void *r, void *to) {
  /* The angles of S are not in the key; what owns something without an entry is gone too soon. */
  if (quantity == CORE_QUANTITY_S ||
      (order->entry == NULL && core_profile_bytes(&order->profile) > 0)) {
    return false;
  }
  struct batch_group *group = find(batch, stats, order, quantity);
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
