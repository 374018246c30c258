/* profiles: a worker's local store of prepared profiles, in front of the cache that all workers
 * share.
 *
 * The store is a table of constant size. A slot holds either a profile that owns no memory, or a
 * copy of a cache entry's profile together with a reference to the entry. The time of preparing a
 * profile decides who prepares and who keeps it:
 *   1 to 2 us (dipoles, Burley): the worker prepares it itself and keeps it only in its table, so
 *     that no stream of such media evicts anything from the cache.
 *   25 to 500 us (single scattering, multipoles, quantized diffusion): the first worker in need
 *     prepares it. Cache and table keep it.
 *   milliseconds and more (transport, tables): a thread of the cache prepares it, so that
 *     neither the worker nor another client's cheap request waits. Cache and table keep it.
 *
 * Other modules, like server/jobs/batch.h, remember the place of a profile in this table. They hold
 * no copies of their own. Without the table a request of 16 radii by a dipole takes 3.4 times as much
 * of the daemon's processor time, and without the cache a table is built for each request in 0.9 to
 * 340 ms, in place of 0.5 us.
 */
#ifndef DIPOLED_PROFILES_H
#define DIPOLED_PROFILES_H

#include "core/varying.h"
#include "server/store/cache.h"

/* The key of a profile: everything from which it is prepared. Two profiles are the same if the
 * bytes of their keys up to the last layer are the same. For that, a key has no padding, no -0, and
 * one NaN for all parameters that are not given. The angles of S are not in the key, because a job
 * sets them in its copy of the profile. */
struct profiles_key {
  uint64_t hash_before_medium;
  uint64_t hash;
  uint32_t model;
  uint32_t moments;
  uint32_t evaluator;
  uint32_t layer_count;
  double parameters[CORE_PARAMETERS_END];
  core_medium medium[CORE_LAYERS_MAX]; /* the layers: the first layer_count count */
};

/* Sets the members of the key that all channels of a request share. */
void profiles_key_start(struct profiles_key *key, unsigned model, unsigned moments,
                        unsigned evaluator, const core_parameters *parameters);

/* Sets the layers of one channel, and the hash. Call it after profiles_key_start(). */
void profiles_key_set_medium(struct profiles_key *key, const core_medium *medium);

bool profiles_key_equal(const struct profiles_key *a, const struct profiles_key *b);

/* Returns the key in the form of the cache, whose content `key` is. */
struct cache_key profiles_cache_key(const struct profiles_key *key, const struct cache_kind *kind);

extern const struct cache_kind profiles_kind; /* kind of thing: core_profile */

/* A profile is found by its hash: in one of PROFILES_SETS sets, in any of its PROFILES_WAYS
 * slots. */
enum { PROFILES_SETS = 64, PROFILES_WAYS = 4 };

struct profiles_slot {
  uint64_t version;          /* rises whenever the slot gets another profile or is emptied */
  unsigned pins;             /* number of users; the slot keeps its profile while it is above 0 */
  struct cache_entry *entry; /* reference to the cache entry; NULL: the profile owns no memory */
  struct profiles_key key;   /* has model 0, which no model has, if the slot is empty */
  core_profile profile;
};

/* The place of a profile: its slot, and the version of the slot at that time. All members are 0 if
 * there is no profile. */
struct profiles_place {
  struct profiles_slot *slot;
  uint64_t version;
};

/* The store of one worker; only its thread uses it. */
struct profiles {
  struct lookups lookups; /* lookups of profiles and of all other kinds */
  bool keeps;             /* false if the cache has 0 bytes: the table then stays empty */
  struct profiles_set {
    uint64_t hashes[PROFILES_WAYS];
    unsigned next; /* index of the slot that is replaced next */
    struct profiles_slot slots[PROFILES_WAYS];
  } sets[PROFILES_SETS];
};

/* A job's lookup of one profile after the other. Before profiles_start(), set on_ready, context and
 * owner of `cached`, and all other members to 0. */
struct profiles_lookup {
  struct lookup cached; /* lookup of the cache entry that was copied */
  struct profiles_key key;
  core_parameters parameters;
  bool ready;                  /* whether `profile` is valid, until profiles_return() */
  core_profile profile;        /* a copy, with the angles of the request */
  struct profiles_place place; /* of the profile without the angles, if the table has it */
  core_fault fault;            /* after LOOKUP_FAULT: the fault */
};

/* Sets up the store. It calls wake(context), on any thread, when the worker should call
 * lookups_wake(). */
void profiles_init(struct profiles *profiles, struct server *server, void (*wake)(void *context),
                   void *context);

/* Empties the table. Call it when no job waits for a profile and no slot is pinned. */
void profiles_end(struct profiles *profiles);

/* Releases the entries that the cache has evicted, so that their memory is freed. Call this a few
 * times a second. */
void profiles_sweep(struct profiles *profiles);

/* Sets the arguments that the next profiles share. core_profile_check() must have accepted them. */
void profiles_start(struct profiles_lookup *lookup, unsigned model, unsigned moments,
                    unsigned evaluator, const core_parameters *parameters);

/* Gets the profile for a medium. The caller has returned the previous profile. After LOOKUP_WAIT
 * and on_ready(), call it again for the same medium. */
enum lookup_state profiles_get(struct profiles *profiles, struct profiles_lookup *lookup,
                               const core_medium *medium);

/* Gets the profile of transport that the model error of a model is computed from, if it needs one
 * (core/ruler.h); else the state is READY, and lookup->ready is false. solves: it may be solved. In
 * place of profiles_start() and profiles_get(). */
enum lookup_state profiles_get_ruler(struct profiles *profiles, struct profiles_lookup *lookup,
                                     unsigned model, const core_parameters *parameters,
                                     const core_medium *medium, bool solves);

/* Returns the profile to the store, or gives up waiting for it. Does nothing if there is neither.
 */
void profiles_return(struct profiles_lookup *lookup);

/* Returns the profile at a place, without the angles of a request. It stays valid until the next
 * profiles_get() or profiles_sweep(), and while the slot is pinned. Returns NULL if the slot has
 * another profile now, or if the cache has evicted this one. */
const core_profile *profiles_at(struct profiles_place place);

/* Looks up what all media of one g and eta share (core/varying.h). core_profile_check() must have accepted the
 * arguments. */
enum lookup_state varyings_get(struct lookups *lookups, struct lookup *lookup, unsigned model,
                               unsigned moments, unsigned evaluator,
                               const core_parameters *parameters, double g, double eta);

/* Returns what varyings_get() has found, until lookup_return(); NULL if there is nothing. */
static inline const core_varying *varyings_found(const struct lookup *lookup) {
  return lookup_thing(lookup);
}

#endif
