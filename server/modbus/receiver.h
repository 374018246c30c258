/* receiver: finds the requests in the bytes of a serial line. It knows neither devices nor clocks:
 * its caller says when bytes arrived and when a silence ended them.
 *
 * A frame begins after a silence of 3.5 characters (MODBUS over Serial Line V1.02, 2.5.1.1), or
 * right after another frame, because adapters deliver several frames together. Other bytes are
 * skipped up to the next silence. Adapters also deliver a frame in pieces, so a short silence may
 * be a pause within a frame. Only the caller's longer silence ends an unfinished frame. If the rest
 * of that frame arrives later, it is skipped, even if it looks like a frame.
 *
 * Some adapters return all bytes that the daemon writes to them: the echo. The receiver skips it.
 * It learns whether there is an echo from replies that cannot be requests, for example those of
 * function 3. A reply of function 6 has the same bytes as its request, so that its echo looks
 * like a request that the master repeats. If the first reply is such a one, the sender probes: it
 * sends the first byte alone and looks whether that comes back.
 */
#ifndef DIPOLED_MODBUS_RECEIVER_H
#define DIPOLED_MODBUS_RECEIVER_H

#include "server/modbus/codec.h"

enum {
  MODBUS_RECEIVER_BYTES = 1024, /* the most bytes that may arrive without a silence */
};

enum modbus_echo {
  MODBUS_ECHO_UNKNOWN,
  MODBUS_ECHO_NONE,  /* the adapter returns nothing */
  MODBUS_ECHO_HEARD, /* the adapter returns what is written */
};

struct modbus_receiver {
  unsigned number;     /* number of the unit whose requests are received */
  uint64_t silence_ns; /* 3.5 characters */
  enum modbus_echo echo;
  uint64_t arrived_ns; /* when bytes last arrived */
  size_t count;        /* number of bytes that are kept */
  size_t fresh;        /* start of the bytes that arrived after the last modbus_receiver_end() */
  size_t late;         /* start of the bytes after the last short silence, if later than fresh */
  unsigned repeats;    /* number of replies in a row that were equal */
  size_t sent_count;   /* length of the frame that was sent and may come back; 0: none may */
  uint8_t sent[MODBUS_RTU_MAX];
  uint8_t bytes[MODBUS_RECEIVER_BYTES];
};

/* What the receiver has found in the bytes before a silence. */
struct modbus_burst {
  bool bad;     /* whether bytes other than frames arrived */
  bool echoed;  /* whether an echo arrived */
  size_t bytes; /* length of the request; 0: there is none */
  uint8_t request[MODBUS_RTU_MAX];
};

/* Forgets all that has arrived, and whether there is an echo. Call it when the device is opened. */
void modbus_receiver_reset(struct modbus_receiver *receiver);

/* Returns where to put the next bytes, and in *room how many fit: at least one. If the line was not
 * silent for very long, drops the first frames that are kept, or all if they are no frames. */
uint8_t *modbus_receiver_room(struct modbus_receiver *receiver, size_t *room);

/* Call it after `count` bytes have been put into the room, at time now_ns. */
void modbus_receiver_arrived(struct modbus_receiver *receiver, size_t count, uint64_t now_ns);

/* Returns whether whole frames have arrived, and nothing else. A silence of 3.5 characters then
 * ends them. */
bool modbus_receiver_is_whole(const struct modbus_receiver *receiver);

/* Call it when a silence has ended the bytes that have arrived. Sets *burst. Its request is the
 * last frame, if that is addressed to the unit or to all units (0). */
void modbus_receiver_end(struct modbus_receiver *receiver, struct modbus_burst *burst);

/* Call it when a frame is going to be sent. Drops what has arrived. If it returns true, the frame
 * is a probe: the caller sends the first byte, waits until something has arrived or until an echo
 * would have arrived, calls modbus_receiver_probed(), and sends the rest. */
bool modbus_receiver_sent(struct modbus_receiver *receiver, const uint8_t *frame, size_t bytes);
void modbus_receiver_probed(struct modbus_receiver *receiver);

#endif
