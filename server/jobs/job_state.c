#include "server/jobs/job_state.h"

#include <stdio.h>
#include <string.h>

wire_error job_error(core_fault fault) {
  wire_error error = wire_error_make(WIRE_STATUS_BAD_VALUE, fault.field, fault.allowed);
  error.index = fault.index;
  return error;
}

wire_error job_busy(void) {
  wire_error error =
      wire_error_make(WIRE_STATUS_BUSY, "", "less at a time: max_total_bytes is in use");
  error.retry_after_ms = JOB_RETRY_AFTER_MS;
  return error;
}

wire_error job_fault(core_fault fault, uint32_t channel) {
  fault.index = channel;
  wire_error error = job_error(fault);
  if (strcmp(fault.field, CORE_FIELD_MEMORY) == 0) {
    error.status = WIRE_STATUS_BUSY;
    error.retry_after_ms = JOB_RETRY_AFTER_MS;
  }
  return error;
}

wire_error job_too_large(const char *field, uint64_t most, const char *what) {
  char allowed[80];
  snprintf(allowed, sizeof allowed, "at most %llu %s", (unsigned long long)most, what);
  return wire_error_make(WIRE_STATUS_TOO_LARGE, field, allowed);
}
