/* bank: the registers and coils of one unit, and the job that they describe.
 *
 * All banks are touched on one worker's thread alone (server/modbus/service.h).
 */
#ifndef DIPOLED_MODBUS_BANK_H
#define DIPOLED_MODBUS_BANK_H

#include <modbus.h>

#include "server/jobs/job.h"
#include "server/modbus/translate.h"

struct worker;

/* Who waits for an answer: a connection or a line. */
struct modbus_client {
  void (*answer)(struct modbus_client *client); /* the bank's job is done: its request may be */
};

/* Banks whose job has been evaluated when batch_finish() has been called. */
struct modbus_banks_done {
  struct modbus_bank *first;
};

struct modbus_bank {
  struct worker *worker; /* NULL: the bank has not been used */
  struct modbus_banks_done *done;
  bool busy;       /* the job waits for a profile */
  bool evaluating; /* among *done */
  struct modbus_bank *next_done;
  struct modbus_client *client; /* that waits for it; NULL: nobody */
  uint16_t token;               /* of the job */
  struct job *job;              /* in the slot; NULL: none */
  struct job_slot slot;
  modbus_mapping_t mapping; /* of the two below */
  uint16_t image[REGISTERS_END];
  uint8_t coils[REGISTERS_COILS];
  _Alignas(8) uint8_t question[MODBUS_QUESTION_BYTES];
  _Alignas(8) uint8_t reply[MODBUS_REPLY_BYTES];
};

/* Before it is first used: all 0. */
void modbus_bank_start(struct modbus_bank *bank, struct worker *worker,
                       struct modbus_banks_done *done);

/* Writes registers, with what that starts; values as in a PDU. 0: done; if bank->evaluating is true
 * now, the client is told when it may be answered. Else the exception, and nothing has changed but
 * the error. */
unsigned modbus_bank_write(struct modbus_bank *bank, unsigned address, unsigned count,
                           const uint8_t *values, struct modbus_client *client);

/* A request to write that was refused before: the status, and the register at fault. */
void modbus_bank_note_refusal(struct modbus_bank *bank, const wire_error *error, unsigned at);

/* batch_finish() has been called: puts the results in place and tells the client. */
void modbus_bank_finish(struct modbus_bank *bank);

/* Its client is gone. */
void modbus_bank_forget(struct modbus_bank *bank, const struct modbus_client *client);

/* Lets go of what the job waits for; the bank is not used any more. */
void modbus_bank_end(struct modbus_bank *bank);

#endif
