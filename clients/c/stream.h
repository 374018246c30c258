/* stream: a non-blocking socket with buffers. */
#ifndef LIBDIPOLE_STREAM_H
#define LIBDIPOLE_STREAM_H

#include "clients/c/dipole.h"

enum { LIBDIPOLE_INPUT_BYTES = 65536 };

/* Bytes that arrive go to `target` while target_bytes > 0, else into in[in_begin .. in_end]. The
 * caller empties this buffer before it sets a target. */
typedef struct libdipole_stream {
  int fd;         /* -1 if there is no connection */
  int send_errno; /* why sending failed, or 0. What the peer has sent is read before that counts. */
  bool silent;    /* The last step ended because its time was over. */
  uint8_t *out;   /* out[out_begin .. out_end] is to be sent */
  size_t out_begin, out_end, out_capacity;
  uint8_t *target;
  size_t target_bytes;
  size_t in_begin, in_end;
  uint8_t in[LIBDIPOLE_INPUT_BYTES];
} libdipole_stream;

void libdipole_stream_init(libdipole_stream *stream, int fd);

/* Closes the socket and frees the buffer. */
void libdipole_stream_close(libdipole_stream *stream);

/* Makes room for so many bytes at out + out_end. The caller writes there and adds to out_end. */
bool libdipole_stream_reserve(libdipole_stream *stream, size_t bytes, dipole_error *error);

/* Sends what the socket takes at once. */
void libdipole_stream_send(libdipole_stream *stream);

/* Waits until bytes can be read or sent, and then reads and sends once. It reads also while it has
 * something to send: otherwise two peers that both send would wait for each other forever.
 * timeout_ms: 0 is no limit. Failures are of kind CONNECTION. */
bool libdipole_stream_step(libdipole_stream *stream, unsigned timeout_ms, dipole_error *error);

#endif
