/* target: a server and what to ask it, again and again: requests of one size, answered by replies
 * of one size, all of which are known beforehand and checked.
 *
 * A target is framed (proto/PROTOCOL.md: a reply names its request, and may come in any order), or
 * its replies come in the order of the requests.
 */
#ifndef DIPOLED_BENCH_SERVICE_TARGET_H
#define DIPOLED_BENCH_SERVICE_TARGET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>

struct target_address {
  struct sockaddr_storage name;
  socklen_t bytes;
};

struct target {
  const char *name;
  pid_t server; /* its process */
  struct target_address address;
  bool framed;
  size_t variants; /* different requests; they are sent in turn */
  size_t request_bytes;
  size_t reply_bytes;
  uint8_t *requests;  /* [variants][request_bytes]; framed: with request id 0 */
  uint8_t *replies;   /* [variants][reply_bytes], likewise */
  size_t values_from; /* up to here a reply is its header and what is not compared */
  size_t check_every; /* the values are compared in each so manieth reply; headers in all */
};

/* A socket to be, in the temporary folder or at a port of 127.0.0.1. */
struct target_address target_unix(const char *path);
struct target_address target_tcp(unsigned port);

/* A listening socket; a TCP address gets the port that it is bound to. */
int target_listen(struct target_address *address);

/* A connected socket, blocking; it gives up on a peer that is silent for TARGET_SILENCE_S. */
enum { TARGET_SILENCE_S = 10 };
int target_connect(const struct target_address *address);

/* Evaluations of R by the better dipole in single precision, skin1, at listed radii from 0.01 to
 * 10 mm. The expected values are computed here. */
void target_make_eval(struct target *target, size_t radius_count);

/* The same requests; all replies are those to the first: for servers that do not look at them. */
void target_make_echo(struct target *target, const struct target *eval);

void target_free(struct target *target);

/* Writes a request id into a request of a framed target. */
void target_set_id(uint8_t *request, uint64_t id);
uint64_t target_id(const uint8_t *reply);

/* Fails when reply is not what the variant's reply should be; values: compares them, too. */
void target_check(const struct target *target, size_t variant, uint64_t id, const uint8_t *reply,
                  bool values);

#endif
