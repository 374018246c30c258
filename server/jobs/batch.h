/* batch: evaluates short eval requests together, and serves repeated requests faster.
 *
 * Passes. In each round of its loop a worker gathers the short requests of all its clients. It
 * evaluates them at the end of the round, before anything is written. The radii of a pass are
 * copied together, and its values are copied to where each request wants them. The values do not
 * depend on which requests share a pass. Without passes a request of 4 radii takes 2.0 times as much of
 * the daemon's processor time with single scattering, and the same with a dipole.
 *
 * Repeated requests. Render farms send requests by the million that differ in their radii alone:
 * their payloads are equal byte by byte up to the radii. The worker remembers requests together
 * with the start of their replies. It does not check a repeated request again, and copies the start
 * of the reply, which gives the same bytes. Without this, a request of 16 radii (service.redis) takes
 * 2.8 times as much of the daemon's processor time.
 */
#ifndef DIPOLED_BATCH_H
#define DIPOLED_BATCH_H

#include "core/ruler.h"
#include "proto/eval.h"
#include "server/observe/stats.h"
#include "server/store/profiles.h"

/* ---- passes ---------------------------------------------------------------------------------- */

enum {
  BATCH_SHORT_RADII = 128, /* the most radii of a request that shares a pass with others */
  BATCH_RADII = 4096,      /* the most radii in one pass */
  BATCH_PIECES = 512,      /* the most requests in one pass */
  BATCH_GROUPS = 4, /* passes that are gathered at a time, each for one profile and quantity */
};

/* The part of one request in a pass. */
struct batch_piece {
  void *to; /* the memory for its values */
  uint32_t count;
};

/* A pass that is being gathered. */
struct batch_group {
  struct profiles_slot *slot; /* pinned; NULL: the group is free */
  enum core_quantity quantity;
  size_t radius_count;
  size_t piece_count;
  struct batch_piece pieces[BATCH_PIECES];
  double radii[BATCH_RADII]; /* the radii, as doubles or as floats */
};

/* The passes that one worker gathers; only its thread uses them. All members start as 0. */
struct batch {
  struct batch_group groups[BATCH_GROUPS];
  unsigned next; /* the group that is evaluated next when a group is needed and none is free */
};

/* Adds n radii (1 to BATCH_SHORT_RADII) to a pass, in the precision of the profile's evaluator.
 * After batch_finish(), the values of the quantity are at `to`. Returns false, and the caller
 * evaluates the radii itself, if the profile at this place is gone, or if the quantity is S, which
 * depends on angles that the profile does not have. */
bool batch_take(struct batch *batch, struct stats *stats, struct profiles_place place,
                enum core_quantity quantity, size_t n, const void *r, void *to);

/* Evaluates all passes that have been gathered. */
void batch_finish(struct batch *batch, struct stats *stats);

/* Writes the errors of a channel's quantities, in their order, to `at`. ruler: the profile of transport,
 * or NULL; radii: their range; requested: those at which the model error is compared, if it is wanted. A
 * model error that is not known is NAN. */
void batch_put_errors(const core_profile *profile, const core_profile *ruler, unsigned wanted,
                      core_radii_range radii, const core_requested_radii *requested, uint8_t *at);

/* ---- repeated requests ----------------------------------------------------------------------- */

/* A request is found by its hash: in one of REPEAT_SETS sets, in any of its REPEAT_WAYS entries. */
enum {
  REPEAT_SETS = 64,
  REPEAT_WAYS = 4,
  REPEAT_CHANNELS = 4,        /* the most channels of a request that is remembered */
  REPEAT_REQUEST_BYTES = 448, /* the longest, without its radii */
  REPEAT_REPLY_BYTES = 576,   /* the longest reply to it, without its arrays */
  REPEAT_RADII_BYTES = 256,   /* the longest list of radii whose errors are not computed again */
};

/* A channel of a request. */
struct repeat_channel {
  struct profiles_place profile;
  struct profiles_place ruler; /* the profile of transport, if the channel is compared with it */
  bool compared;
};

/* A request that has been served, and the start of the reply to it with the last radii. */
struct repeat_entry {
  uint64_t hash;
  size_t request_bytes; /* size up to the radii; 0 if the entry is empty */
  size_t payload_bytes; /* size with the radii */
  size_t reply_bytes;
  size_t head_bytes; /* of the reply, before its arrays */
  size_t array_bytes;
  size_t value_bytes;
  size_t count; /* number of radii */
  unsigned model;
  unsigned wanted;
  core_grid grid;                      /* the radii, if they are not listed */
  size_t radius_offset, errors_offset; /* in the reply */
  size_t channel_count;
  struct repeat_channel channels[REPEAT_CHANNELS];
  uint8_t request[REPEAT_REQUEST_BYTES];
  uint8_t reply[REPEAT_REPLY_BYTES];
  uint8_t radii[REPEAT_RADII_BYTES]; /* the last ones, if they are listed and not too many */
};

/* The requests that one worker remembers; only its thread uses them. All members start as 0. */
struct repeat {
  struct repeat_set {
    unsigned next; /* the entry that is replaced next */
    struct repeat_entry entries[REPEAT_WAYS];
  } sets[REPEAT_SETS];
};

/* Remembers a request whose reply is one complete part, unless it is too long or cannot be repeated
 * (see can_repeat() in batch.c). The caller has checked the request,
 * and the check holds for any radii, because the request names a model that covers all radii. */
void repeat_learn(struct repeat *repeat, const eval_request *request, const core_grid *grid,
                  const eval_layout *layout, const uint8_t *reply,
                  const struct repeat_channel *channels);

/* Finds the remembered request that this one repeats. Returns NULL if there is none, if a profile
 * is gone, or if a radius is out of range; the caller then treats the request as a new one. If the
 * radii are listed and not the last ones, sets *radii to their range (core_radii_check_f64()). */
struct repeat_entry *repeat_find(struct repeat *repeat, const uint8_t *payload,
                                 size_t payload_bytes, core_radii_range *radii);

/* Fills in a reply of entry->reply_bytes, whose values follow in batch_finish(). range: set by
 * repeat_find(); radii: working space for BATCH_SHORT_RADII numbers. Call it after repeat_find(),
 * before another profile is got. */
void repeat_reply(struct repeat_entry *entry, struct batch *batch, struct stats *stats,
                  const uint8_t *payload, core_radii_range range, double *radii, uint8_t *reply);

#endif
