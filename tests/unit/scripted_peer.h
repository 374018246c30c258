/* scripted_peer: a small daemon for tests of the client library. On a thread of its own, it accepts
 * one connection at a time on a Unix socket and runs a script of the test on it. */
#ifndef DIPOLED_TESTS_SCRIPTED_PEER_H
#define DIPOLED_TESTS_SCRIPTED_PEER_H

#include <pthread.h>

#include "clients/c/dipole.h"
#include "proto/wire.h"

typedef struct peer_frame {
  wire_header header;
  uint8_t *payload; /* The receiver frees it. */
} peer_frame;

typedef struct scripted_peer {
  char folder[64];
  char address[96]; /* for dipole_open() */
  int listener;
  void (*const *scripts)(int fd, void *context); /* NULL: there is only `script` */
  void (*script)(int fd, void *context);
  void *context;
  pthread_t thread;
} scripted_peer;

/* Starts to listen. The script runs when a client has connected. */
void peer_start(scripted_peer *peer, void (*script)(int fd, void *context), void *context);

/* Starts to listen and accepts one connection after the other. Each one runs the next script of the
 * list, which ends with NULL. */
void peer_start_scripts(scripted_peer *peer, void (*const *scripts)(int fd, void *context),
                        void *context);

/* Waits for the script to end. */
void peer_end(scripted_peer *peer);

/* Scripts call these functions. They return false if the other side is gone. */
bool peer_receive(int fd, peer_frame *frame);
bool peer_send(int fd, uint16_t type, uint64_t id, const void *payload, size_t payload_bytes);
bool peer_send_bytes(int fd, const void *bytes, size_t count);

/* Answers hello with a model "better" and a status "bad-value". */
bool peer_say_hello(int fd);

/* Makes the correct answer to an eval request with listed radii: R = 2 r, cdf = r / 4, S = 3 r,
 * albedo = the medium's sigma_a, model error = cos_in, notes = the number of parameters. The caller
 * frees *payload. Returns its length. */
size_t peer_evaluate(const peer_frame *request, uint8_t **payload);

/* Makes one part of the correct answer, like peer_evaluate(). If the request has a grid, every
 * radius and every value is its own position. */
size_t peer_evaluate_part(const peer_frame *request, uint64_t radius_first, uint64_t radius_count,
                          uint32_t part, uint32_t part_count, uint8_t **payload);

/* A script that says hello and then answers correctly until the client is gone. */
void peer_serve(int fd, void *context);

#endif
