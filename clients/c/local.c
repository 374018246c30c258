/* What the library knows without a daemon: its own lists, and radii by rule. */
#include <stdlib.h>

#include "clients/c/client.h"
#include "core/core.h"

/* The caller's block: the info, then what it points to. */
typedef struct local_info {
  dipole_info info;
  wire_choice *texts;
  dipole_choice choices[];
} local_info;

bool dipole_local_info(dipole_info **info, dipole_error *error) {
  dipole_error unwanted;
  const size_t count = wire_choice_count();
  local_info *local = malloc(sizeof *local + count * (sizeof(dipole_choice) + sizeof(wire_choice)));
  if (local == NULL) {
    return libdipole_fail(error != NULL ? error : &unwanted, DIPOLE_ERROR_MEMORY, "out of memory");
  }
  local->texts = (wire_choice *)(void *)(local->choices + count);
  for (size_t i = 0; i < count; i++) {
    wire_choice *text = &local->texts[i];
    *text = wire_choice_at(i);
    local->choices[i] = (dipole_choice){.kind = (enum dipole_kind)text->kind,
                                        .id = text->id,
                                        .name = text->name,
                                        .about = text->about};
  }
  local->info = (dipole_info){.address = "",
                              .software = "libdipole " DIPOLED_VERSION,
                              .instruction_set = core_isa_name(core_isa_select(NULL)),
                              .R_unit = WIRE_R_UNIT,
                              .protocol_version = WIRE_VERSION,
                              .choices = local->choices,
                              .choice_count = count};
  *info = &local->info;
  return true;
}

bool dipole_grid_radii(enum dipole_spacing spacing, double start_mm, double stop_mm, uint64_t count,
                       float *r, dipole_error *error) {
  dipole_error unwanted;
  const core_grid grid = {.spacing = (enum core_spacing)spacing,
                          .count = count,
                          .start_mm = start_mm,
                          .stop_mm = stop_mm};
  error = error != NULL ? error : &unwanted;
  if (spacing != DIPOLE_LINEAR && spacing != DIPOLE_LOGARITHMIC) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT,
                          "spacing is DIPOLE_LINEAR or DIPOLE_LOGARITHMIC");
  }
  const core_fault fault = core_grid_check(&grid);
  if (fault.field != NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_ARGUMENT, "%s: allowed: %s", fault.field,
                          fault.allowed);
  }
  core_grid_radii_f32(&grid, 0, (size_t)count, r);
  return true;
}
