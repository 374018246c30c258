/* codec: libmodbus, where it makes answers of requests that have been checked. */
#ifndef DIPOLED_MODBUS_CODEC_H
#define DIPOLED_MODBUS_CODEC_H

#include <modbus.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* For TCP. libmodbus writes an answer to a socket: to the client's own while it surely takes it, or
 * to one end of a pair, from which it is read back. */
struct modbus_codec {
  modbus_t *context;
  int pair[2];
};

bool modbus_codec_open(struct modbus_codec *codec);
void modbus_codec_close(struct modbus_codec *codec);

/* Answers a request (a whole frame) with what the mapping holds, which it writes to if the request
 * says so; or with an exception, if that is not 0. Bytes that were written to the context's socket;
 * -1, and errno. */
int modbus_codec_answer(modbus_t *context, const uint8_t *frame, size_t bytes,
                        modbus_mapping_t *mapping, unsigned exception);

/* The same to a socket. */
int modbus_codec_send(struct modbus_codec *codec, int fd, const uint8_t *frame, size_t bytes,
                      modbus_mapping_t *mapping, unsigned exception);

/* The same to a buffer, with room for MODBUS_TCP_MAX_ADU_LENGTH; -1: it could not be done. */
int modbus_codec_encode(struct modbus_codec *codec, const uint8_t *frame, size_t bytes,
                        modbus_mapping_t *mapping, unsigned exception, uint8_t *answer);

#endif
