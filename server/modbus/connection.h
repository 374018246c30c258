/* connection: one Modbus master over TCP. It cuts the stream into frames, has them answered in
 * their order, and writes the answers, without ever waiting for the peer.
 *
 * While an answer has not been written whole, no further request is taken up and nothing is read:
 * so one answer at most is kept, and a master that does not read costs what its structure takes.
 */
#ifndef DIPOLED_MODBUS_CONNECTION_H
#define DIPOLED_MODBUS_CONNECTION_H

#include <uv.h>

#include "server/modbus/answer.h"

struct modbus_service;

enum {
  MODBUS_FRAME_MAX = 260,    /* bytes of a frame over TCP */
  MODBUS_INPUT_BYTES = 1040, /* that are read ahead */
};

struct modbus_connection {
  struct modbus_client client; /* first: it is found by its address */
  struct modbus_service *service;
  struct modbus_connection *next; /* in the service's list of all, or its inbox */
  struct modbus_connection *previous;
  struct modbus_connection *next_to_run;
  int fd;
  uv_poll_t poll;
  int events; /* that the poll waits for */

  bool to_run;  /* in the run queue */
  bool waiting; /* its first frame is being evaluated, on: */
  struct modbus_bank *bank;
  bool stopping;   /* nothing more is read: the peer or the daemon has done */
  unsigned unread; /* bytes that had arrived when the daemon's stop was wanted */
  bool ending;     /* no more frames are taken; closes when all is written */
  bool lingering;  /* shut down; waits for the peer to close, so that it can read the last answer */
  bool closing;    /* uv_close() has been called */

  uint64_t active_ms;        /* when bytes last arrived or left */
  uint64_t frame_started_ms; /* when the unfinished frame began to arrive; 0: there is none */
  unsigned unconfirmed;      /* bytes written that the peer may not have taken yet */
  unsigned begin;            /* of what has arrived and not been answered */
  unsigned end;
  unsigned unsent_begin; /* of the answer that the socket has not taken */
  unsigned unsent_end;
  uint8_t input[MODBUS_INPUT_BYTES];
  uint8_t unsent[MODBUS_FRAME_MAX];
};

/* For a connected socket that does not block, which it owns from now on; NULL: no memory, fd is
 * still the caller's. Any thread. */
struct modbus_connection *modbus_connection_new(struct modbus_service *service, int fd);

/* On the worker's thread, all of them. */
void modbus_connection_start(struct modbus_connection *connection);
void modbus_connection_run(struct modbus_connection *connection); /* its turn in the run queue */
void modbus_connection_tick(struct modbus_connection *connection, uint64_t now_ms);
void modbus_connection_stop(struct modbus_connection *connection);
void modbus_connection_abort(struct modbus_connection *connection);

#endif
