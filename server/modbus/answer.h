/* answer: what a request does to the registers of its unit, and what it is answered with.
 * Independent of sockets and lines.
 */
#ifndef DIPOLED_MODBUS_ANSWER_H
#define DIPOLED_MODBUS_ANSWER_H

#include "server/modbus/bank.h"
#include "server/modbus/pdu.h"

struct modbus_service;

enum { MODBUS_UNITS = 247 };

struct modbus_answer {
  struct modbus_bank *bank;
  bool later;         /* the client is told when its request can be answered, from the bank */
  unsigned exception; /* that it gets; 0: none */
  size_t bytes;       /* of the PDU below, which is the answer; 0: the codec makes it */
  uint8_t pdu[MODBUS_PDU_MAX];
};

/* Carries out the request of a unit, 0: one that is not there. pdu: at least 1 byte, which is less
 * than 0x80. */
void modbus_answer(struct modbus_service *service, struct modbus_client *client, unsigned unit,
                   const uint8_t *pdu, size_t bytes, struct modbus_answer *answer);

#endif
