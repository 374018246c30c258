/* fuzz: what the targets share. A target is a function that libFuzzer calls with arbitrary bytes.
 * It checks the properties that must hold for any bytes, and aborts if one does not. */
#ifndef DIPOLED_TESTS_FUZZ_H
#define DIPOLED_TESTS_FUZZ_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* X(name, start): the target NAME is fuzz_NAME(). `start` is called once before its first input. */
#define FUZZ_TARGETS(X)                                                                            \
  X(frames, fuzz_daemon_start)                                                                     \
  X(messages, fuzz_start_nothing)                                                                  \
  X(requests, fuzz_daemon_start)                                                                   \
  X(connection, fuzz_daemon_start)                                                                 \
  X(modbus, fuzz_modbus_start)                                                                     \
  X(rtu, fuzz_modbus_start)                                                                        \
  X(scpi, fuzz_daemon_start)                                                                       \
  X(http, fuzz_daemon_start)                                                                       \
  X(table, fuzz_table_start)                                                                       \
  X(surface, fuzz_surface_start)                                                                   \
  X(replies, fuzz_start_nothing)                                                                   \
  X(csv, fuzz_csv_start)                                                                           \
  X(texts, fuzz_texts_start)

#define FUZZ_DECLARE(name, start)                                                                  \
  void start(void);                                                                                \
  void fuzz_##name(const uint8_t *data, size_t size);
FUZZ_TARGETS(FUZZ_DECLARE)

#define CHECK(condition)                                                                           \
  ((condition) ? (void)0 : fuzz_fail(__FILE__ ":" FUZZ_TEXT(__LINE__) ": " #condition "\n"))
#define FUZZ_TEXT(x) FUZZ_TEXT_OF(x)
#define FUZZ_TEXT_OF(x) #x

/* Writes the text to the standard error and aborts. */
_Noreturn void fuzz_fail(const char *text);

/* Returns a copy in a block of exactly its size, at a multiple of 8, so that a sanitizer sees each
 * read past its end. The caller frees it. */
uint8_t *fuzz_copy(const uint8_t *data, size_t size);

/* How the bytes of an input are delivered, which its first bytes say. */
struct fuzz_delivery {
  unsigned piece; /* 0: all at once; else pieces of 1 to this many bytes */
  uint32_t random;
  const uint8_t *at;
  size_t left;
};

/* Returns the delivery of data[1] to data[size - 1], as data[0] says. size: 1 or more. */
struct fuzz_delivery fuzz_delivery_begin(const uint8_t *data, size_t size);

/* Sets *piece to the next piece and returns its length, which is 0 at the end. */
size_t fuzz_delivery_next(struct fuzz_delivery *delivery, const uint8_t **piece);

/* A buffer that gathers bytes. It begins with zeros, and its owner frees `bytes`. */
struct fuzz_bytes {
  uint8_t *bytes;
  size_t count;
  size_t room;
};

/* Makes room for so many bytes behind those gathered, and returns where they begin. */
uint8_t *fuzz_gather(struct fuzz_bytes *gathered, size_t bytes);

/* Takes the payload of a reply apart, reads all its bytes, and returns whether it is one. `type`: that
 * of a reply in parts, of a table or of points. */
bool fuzz_decode_reply(unsigned type, const uint8_t *payload, size_t size);

/* Checks the values of a daemon's reply to eval or, if `drawn` is true, to sample. */
void fuzz_check_evaluated(const uint8_t *payload, size_t size, bool drawn);

#endif
