#include "server/modbus/codec.h"

#include <sys/socket.h>
#include <unistd.h>

bool modbus_codec_open(struct modbus_codec *codec) {
  codec->pair[0] = codec->pair[1] = -1;
  codec->context = modbus_new_tcp("127.0.0.1", 502); /* an address that it never connects to */
  return codec->context != NULL &&
         socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, codec->pair) == 0;
}

void modbus_codec_close(struct modbus_codec *codec) {
  if (codec->context != NULL) {
    modbus_free(codec->context);
  }
  for (int i = 0; i < 2; i++) {
    if (codec->pair[i] >= 0) {
      close(codec->pair[i]);
    }
  }
}

int modbus_codec_answer(modbus_t *context, const uint8_t *frame, size_t bytes,
                        modbus_mapping_t *mapping, unsigned exception) {
  return exception != 0 ? modbus_reply_exception(context, frame, exception)
                        : modbus_reply(context, frame, (int)bytes, mapping);
}

int modbus_codec_send(struct modbus_codec *codec, int fd, const uint8_t *frame, size_t bytes,
                      modbus_mapping_t *mapping, unsigned exception) {
  modbus_set_socket(codec->context, fd);
  return modbus_codec_answer(codec->context, frame, bytes, mapping, exception);
}

int modbus_codec_encode(struct modbus_codec *codec, const uint8_t *frame, size_t bytes,
                        modbus_mapping_t *mapping, unsigned exception, uint8_t *answer) {
  const int sent = modbus_codec_send(codec, codec->pair[0], frame, bytes, mapping, exception);
  return sent > 0 ? (int)recv(codec->pair[1], answer, MODBUS_TCP_MAX_ADU_LENGTH, 0) : -1;
}
