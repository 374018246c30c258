#include "server/jobs/batch.h"

#include <math.h>
#include <string.h>

/* ---- passes ---------------------------------------------------------------------------------- */

static size_t value_bytes(const struct batch_group *group) {
  return core_evaluator_bytes(group->slot->profile.evaluator);
}

static void evaluate_group(struct batch_group *group, struct stats *stats) {
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
  stats_add(stats, STATS_BATCHES_EVALUATED, 1);
  stats_add(stats, STATS_BATCHED_REQUESTS, group->piece_count);
  group->radius_count = 0;
  group->piece_count = 0;
}

/* Evaluates a group, which is then free for another profile. */
static void clear(struct batch_group *group, struct stats *stats) {
  if (group->slot != NULL) {
    evaluate_group(group, stats);
    group->slot->pins--;
    group->slot = NULL;
  }
}

static struct batch_group *find_group(struct batch *batch, struct stats *stats,
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

static void add_radii(struct batch *batch, struct stats *stats, struct profiles_slot *slot,
                      enum core_quantity quantity, size_t n, const void *r, void *to) {
  struct batch_group *group = find_group(batch, stats, slot, quantity);
  if (group->piece_count == BATCH_PIECES || group->radius_count + n > BATCH_RADII) {
    evaluate_group(group, stats);
  }
  const size_t bytes = value_bytes(group);
  memcpy((uint8_t *)group->radii + group->radius_count * bytes, r, n * bytes);
  group->radius_count += n;
  group->pieces[group->piece_count++] = (struct batch_piece){to, (uint32_t)n};
}

bool batch_take(struct batch *batch, struct stats *stats, struct profiles_place place,
                enum core_quantity quantity, size_t n, const void *r, void *to) {
  if ((quantity & (CORE_QUANTITY_S | CORE_QUANTITY_MODEL_ERRORS)) != 0 ||
      profiles_at(place) == NULL) {
    return false;
  }
  add_radii(batch, stats, place.slot, quantity, n, r, to);
  return true;
}

void batch_finish(struct batch *batch, struct stats *stats) {
  for (size_t i = 0; i < BATCH_GROUPS; i++) {
    clear(&batch->groups[i], stats);
  }
}

/* ---- finding repeated requests --------------------------------------------------------------- */

/* Returns the bytes of an eval request before its radii. fixed: its fixed part, whose counts may be
 * wrong: then the bytes are, too, but no request with such counts is remembered. */
static uint64_t bytes_before_radii(const wire_eval_request *fixed) {
  return WIRE_BYTES_eval_request + (uint64_t)fixed->parameter_count * WIRE_BYTES_parameter +
         (uint64_t)fixed->medium_count * fixed->layer_count * WIRE_BYTES_medium;
}

/* Returns the size of an eval request up to its radii, or 0 if it is a request that repeat_learn()
 * never remembers. */
static size_t start_bytes(const uint8_t *payload, size_t payload_bytes) {
  if (payload_bytes < WIRE_BYTES_eval_request) {
    return 0;
  }
  wire_eval_request fixed;
  wire_get_eval_request(payload, &fixed);
  const uint64_t bytes = bytes_before_radii(&fixed);
  return fixed.medium_count <= REPEAT_CHANNELS && bytes <= REPEAT_REQUEST_BYTES &&
                 bytes <= payload_bytes
             ? (size_t)bytes
             : 0;
}

/* Finds the entry with the same bytes up to the radii. Returns NULL if there is none. */
static struct repeat_entry *look_up(struct repeat *repeat, uint64_t hash, const uint8_t *request,
                                    size_t bytes) {
  struct repeat_set *set = &repeat->sets[hash % REPEAT_SETS];
  for (size_t i = 0; i < REPEAT_WAYS; i++) {
    struct repeat_entry *entry = &set->entries[i];
    if (entry->hash == hash && entry->request_bytes == bytes &&
        memcmp(entry->request, request, bytes) == 0) {
      return entry;
    }
  }
  return NULL;
}

static bool radii_are_right(const struct repeat_entry *entry, const uint8_t *radii,
                            core_radii_range *range) {
  static const uint8_t zeros[WIRE_ALIGNMENT];
  const size_t bytes = entry->count * entry->value_bytes;
  const core_fault fault =
      entry->value_bytes == sizeof(float)
          ? core_radii_check_f32(entry->count, (const float *)(const void *)radii, range)
          : core_radii_check_f64(entry->count, (const double *)(const void *)radii, range);
  return fault.field == NULL &&
         memcmp(radii + bytes, zeros, (size_t)wire_padded(bytes) - bytes) == 0;
}

static bool profiles_are_there(size_t channel_count, const struct repeat_channel *channels) {
  for (size_t i = 0; i < channel_count; i++) {
    if (profiles_at(channels[i].profile) == NULL ||
        (channels[i].compared && profiles_at(channels[i].ruler) == NULL)) {
      return false;
    }
  }
  return true;
}

/* Returns the bytes of the listed radii; 0 for a grid. */
static size_t listed_bytes(const struct repeat_entry *entry) {
  return entry->payload_bytes - entry->request_bytes;
}

/* Returns whether radii are those that the entry's start of a reply is for. */
static bool are_last(const struct repeat_entry *entry, const uint8_t *radii) {
  return listed_bytes(entry) <= sizeof entry->radii &&
         memcmp(radii, entry->radii, listed_bytes(entry)) == 0;
}

struct repeat_entry *repeat_find(struct repeat *repeat, const uint8_t *payload,
                                 size_t payload_bytes, core_radii_range *radii) {
  const size_t bytes = start_bytes(payload, payload_bytes);
  if (bytes == 0) {
    return NULL;
  }
  struct repeat_entry *entry = look_up(repeat, cache_hash(0, payload, bytes), payload, bytes);
  return entry != NULL && entry->payload_bytes == payload_bytes &&
                 profiles_are_there(entry->channel_count, entry->channels) &&
                 (are_last(entry, payload + bytes) ||
                  radii_are_right(entry, payload + bytes, radii))
             ? entry
             : NULL;
}

/* ---- serving them -------------------------------------------------------------------------- */

static const void *radii_of(const struct repeat_entry *entry, const uint8_t *payload,
                            double *radii) {
  if (listed_bytes(entry) > 0) {
    return payload + entry->request_bytes;
  }
  core_grid_radii(&entry->grid, 0, entry->count, entry->value_bytes == sizeof(float), radii);
  return radii;
}

void batch_put_errors(const core_profile *profile, const core_profile *ruler, unsigned wanted,
                      core_radii_range radii, const core_requested_radii *requested, uint8_t *at) {
  enum { NOT_DRAWN = CORE_OF_CHANNEL | CORE_QUANTITY_MODEL_ERRORS };
  const bool drawn = (wanted & EVAL_DRAWN) != 0;
  double worst = (double)NAN; /* passes those over that cannot be compared */
  for (unsigned left = wanted & ~EVAL_DRAWN; left != 0;
       left &= left - 1, at += WIRE_BYTES_quantity_error) {
    const unsigned quantity = left & ~(left - 1);
    /* A sample's values are as exact as the cdf that gives the radii. */
    const bool is_drawn = drawn && (quantity & NOT_DRAWN) == 0;
    const unsigned with = quantity | (is_drawn ? (unsigned)CORE_QUANTITY_CDF : 0);
    const core_stated_errors stated = core_profile_errors(profile, with, radii);
    const double off = (wanted & CORE_QUANTITY_MODEL_ERROR) == 0 ? (double)NAN
                       : quantity == CORE_QUANTITY_MODEL_ERROR
                           ? worst
                           : core_model_error(profile, ruler, with, requested);
    const wire_quantity_error error = {stated.numerical, stated.numerical_per_mm,
                                       isinf(off) ? (double)NAN : off};
    worst = fmax(worst, off);
    wire_put_quantity_error(at, &error);
  }
}

/* Remembers the start of a reply, and its radii, if they are not too many. */
static void keep_head(struct repeat_entry *entry, const uint8_t *radii, const uint8_t *reply) {
  memcpy(entry->reply, reply, entry->head_bytes);
  memcpy(entry->radii, radii, listed_bytes(entry) <= sizeof entry->radii ? listed_bytes(entry) : 0);
}

/* Writes the listed radii, if they are wanted, and the errors that hold for them. The last radii, and
 * those of a grid, need none of this: the entry's start of a reply states them and their errors. The
 * slots hold the profiles that repeat_find() has seen, though another worker may evict them meanwhile. */
static void put_listed(struct repeat_entry *entry, const uint8_t *radii, core_radii_range range,
                       uint8_t *reply) {
  const core_requested_radii requested = {entry->grid, radii, range};
  uint8_t *at = reply + entry->errors_offset;
  if ((entry->wanted & CORE_QUANTITY_RADIUS) != 0) {
    memcpy(reply + entry->radius_offset, radii, listed_bytes(entry));
  }
  for (size_t i = 0; i < entry->channel_count; i++) {
    const struct repeat_channel *channel = &entry->channels[i];
    batch_put_errors(&channel->profile.slot->profile,
                     channel->compared ? &channel->ruler.slot->profile : NULL, entry->wanted, range,
                     &requested, at);
    at += schema_bit_count(entry->wanted) * WIRE_BYTES_quantity_error;
  }
  keep_head(entry, radii, reply);
}

/* Adds the radii to the passes of a channel's quantities. Returns the end of the channel's arrays. */
static uint8_t *take_channel(const struct repeat_entry *entry, struct profiles_slot *slot,
                             struct batch *batch, struct stats *stats, const void *r, uint8_t *to) {
  const size_t used = entry->count * entry->value_bytes;
  for (unsigned left = entry->wanted; left != 0; left &= left - 1) {
    const unsigned quantity = left & ~(left - 1);
    if (eval_is_array(entry->wanted, quantity)) {
      add_radii(batch, stats, slot, quantity, entry->count, r, to);
      memset(to + used, 0, entry->array_bytes - used);
      to += entry->array_bytes;
    }
  }
  return to;
}

void repeat_reply(struct repeat_entry *entry, struct batch *batch, struct stats *stats,
                  const uint8_t *payload, core_radii_range range, double *radii, uint8_t *reply) {
  const void *r = radii_of(entry, payload, radii);
  memcpy(reply, entry->reply, entry->head_bytes);
  if (!are_last(entry, payload + entry->request_bytes)) {
    put_listed(entry, payload + entry->request_bytes, range, reply);
  }
  uint8_t *to = reply + entry->head_bytes;
  for (size_t channel = 0; channel < entry->channel_count; channel++) {
    to = take_channel(entry, entry->channels[channel].profile.slot, batch, stats, r, to);
    stats_add(stats, STATS_CACHE_HITS, 1 + entry->channels[channel].compared);
    stats_count_radii(stats, entry->model, entry->count);
  }
}

/* ---- remembering requests -------------------------------------------------------------------- */

/* Returns whether repeat_learn() may keep a request, so that repeat_find() finds it when a client
 * sends it again. A request for S or MODEL_ERRORS is not kept: no pass evaluates them, as S depends on
 * angles, which the profiles in the table do not have, and MODEL_ERRORS on another profile. */
static bool can_repeat(const wire_eval_request *fixed, const eval_layout *layout,
                       const struct repeat_channel *channels) {
  return fixed->medium_count <= REPEAT_CHANNELS && fixed->radius_count > 0 &&
         fixed->radius_count <= BATCH_SHORT_RADII && layout->arrays_per_channel > 0 &&
         (fixed->wanted & (CORE_QUANTITY_S | CORE_QUANTITY_MODEL_ERRORS)) == 0 &&
         bytes_before_radii(fixed) <= REPEAT_REQUEST_BYTES &&
         layout->arrays_offset <= REPEAT_REPLY_BYTES &&
         profiles_are_there(fixed->medium_count, channels);
}

/* Returns the entry for a request: the one that already holds it, or else the one that is to be
 * replaced next among the entries of the request's hash. */
static struct repeat_entry *make_room(struct repeat *repeat, const uint8_t *request, size_t bytes) {
  const uint64_t hash = cache_hash(0, request, bytes);
  struct repeat_entry *entry = look_up(repeat, hash, request, bytes);
  if (entry == NULL) {
    struct repeat_set *set = &repeat->sets[hash % REPEAT_SETS];
    entry = &set->entries[set->next];
    set->next = (set->next + 1) % REPEAT_WAYS;
    entry->hash = hash;
  }
  return entry;
}

void repeat_learn(struct repeat *repeat, const eval_request *request, const core_grid *grid,
                  const eval_layout *layout, const uint8_t *reply,
                  const struct repeat_channel *channels) {
  const wire_eval_request *fixed = &request->fixed;
  if (!can_repeat(fixed, layout, channels)) {
    return;
  }
  const uint8_t *payload = (const uint8_t *)request->media - WIRE_BYTES_eval_request;
  const size_t bytes = (size_t)bytes_before_radii(fixed);
  const size_t value_bytes = core_evaluator_bytes(fixed->evaluator);
  const size_t listed = request->radii != NULL ? (size_t)fixed->radius_count * value_bytes : 0;
  struct repeat_entry *entry = make_room(repeat, payload, bytes);
  entry->request_bytes = bytes;
  entry->payload_bytes = bytes + (size_t)wire_padded(listed);
  entry->reply_bytes = (size_t)layout->payload_bytes;
  entry->head_bytes = (size_t)layout->arrays_offset;
  entry->array_bytes = (size_t)layout->array_bytes;
  entry->value_bytes = value_bytes;
  entry->count = (size_t)fixed->radius_count;
  entry->model = fixed->model;
  entry->wanted = fixed->wanted;
  entry->grid = *grid;
  entry->channel_count = fixed->medium_count;
  entry->radius_offset = (size_t)layout->radius_offset;
  entry->errors_offset = (size_t)layout->errors_offset;
  memcpy(entry->channels, channels, fixed->medium_count * sizeof *channels);
  memcpy(entry->request, payload, bytes);
  keep_head(entry, payload + bytes, reply);
}
