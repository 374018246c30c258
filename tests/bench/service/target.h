/* target: a server and the requests that a benchmark sends it again and again. All requests have
 * one size and all replies have one size. The replies are known beforehand, and each reply is
 * checked.
 *
 * Frames are those of proto/PROTOCOL.md: a reply names its request, and replies may come in any
 * order.
 */
#ifndef DIPOLED_BENCH_SERVICE_TARGET_H
#define DIPOLED_BENCH_SERVICE_TARGET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>

#include "core/varying.h"

struct target_address {
  struct sockaddr_storage name;
  socklen_t bytes;
};

struct target {
  const char *name;
  pid_t server; /* the process of the server */
  struct target_address address;
  size_t variants; /* number of different requests, which are sent in turn */
  size_t request_bytes;
  size_t reply_bytes;
  uint8_t *requests;  /* [variants][request_bytes]; request ids are 0 */
  uint8_t *replies;   /* [variants][reply_bytes]; request ids are 0 */
  size_t values_from; /* offset of the first byte of a reply that is compared, after the header */
  size_t check_every; /* values are compared in one of this many replies, headers in all replies */
};

/* Makes the address of a Unix socket, or of a port of 127.0.0.1. */
struct target_address target_unix(const char *path);
struct target_address target_tcp(unsigned port);

/* Returns a listening socket. If the port of a TCP address is 0, *address gets the port that the
 * system chose. */
int target_listen(struct target_address *address);

/* Returns a connected, blocking socket, whose reads fail when the peer is silent for
 * TARGET_SILENCE_S seconds. */
enum { TARGET_SILENCE_S = 10 };
int target_connect(const struct target_address *address);

/* Makes requests that evaluate R of skin1 by the better dipole in single precision, at listed radii
 * from 0.01 to 10 mm. The expected values are computed in this process. */
void target_make_eval(struct target *target, size_t radius_count);

/* Makes a request of `count` values each of which has a medium of its own: R by a model in single
 * precision. varying: the model, prepared for the media's g and eta. */
void target_make_varying(struct target *target, const core_varying *varying, size_t count);

/* Makes a target with the same requests, whose replies are all equal to the first reply. It is for
 * servers that do not look at requests. */
void target_make_echo(struct target *target, const struct target *eval);

void target_free(struct target *target);

/* These write and read the request id of a frame. */
void target_set_id(uint8_t *request, uint64_t id);
uint64_t target_id(const uint8_t *reply);

/* Stops the benchmark when the header of reply is not that of the variant's reply with this id, or,
 * if values is true, when its values differ. */
void target_check(const struct target *target, size_t variant, uint64_t id, const uint8_t *reply,
                  bool values);

#endif
