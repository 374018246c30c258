/* stream: a non-blocking socket with buffers. */
#ifndef LIBDIPOLE_STREAM_H
#define LIBDIPOLE_STREAM_H

#include "clients/c/dipole.h"
#include "clients/c/tls.h"

enum { LIBDIPOLE_INPUT_BYTES = 65536 };

/* Received bytes go to `target` while target_bytes > 0, and else to the buffer `in`, of which bytes
 * in_begin to in_end - 1 are in use. The caller empties the buffer before it sets a target. */
typedef struct libdipole_stream {
  int fd;             /* the socket; -1: no connection */
  libdipole_tls *tls; /* NULL: the bytes are plain */
  char address[128];  /* address of the peer, for messages; "" if it is not known */
  int send_errno;     /* errno of a failed send, or 0; reported after all received bytes are read */
  bool heard;         /* whether any byte has been received */
  bool silent;        /* whether the last step ended by timeout_ms */
  uint8_t *out;       /* bytes out_begin to out_end - 1 are still to be sent */
  size_t out_begin, out_end, out_capacity;
  uint8_t *target;
  size_t target_bytes;
  size_t in_begin, in_end;
  uint8_t in[LIBDIPOLE_INPUT_BYTES];
} libdipole_stream;

void libdipole_stream_init(libdipole_stream *stream, int fd);

/* Closes the socket, and frees the session and the buffer. is_ours: whether the connection ends,
 * even where a forked process holds the socket, too; false in such a process. */
void libdipole_stream_close(libdipole_stream *stream, bool is_ours);

/* Makes room for this many bytes at out + out_end. The caller writes there and raises out_end. */
bool libdipole_stream_reserve(libdipole_stream *stream, size_t bytes, dipole_error *error);

/* Sends as many bytes as the socket takes without waiting. */
void libdipole_stream_send(libdipole_stream *stream);

/* Waits for events of the socket like libdipole_wait(), or finds bytes that TLS has received. */
bool libdipole_stream_wait(const libdipole_stream *stream, short events, unsigned timeout_ms,
                           short *ready);

/* Waits until bytes can be read or sent, and then reads and sends once. If neither peer read while
 * it has bytes to send, both could wait for each other forever.
 * timeout_ms: 0 is no limit. Failures are of kind CONNECTION. */
bool libdipole_stream_step(libdipole_stream *stream, unsigned timeout_ms, dipole_error *error);

#endif
