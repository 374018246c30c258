/* The table of `dipole mc` for people, as CSV and as JSON. */
#include <math.h>

#include "clients/cli/json.h"
#include "clients/cli/mc.h"
#include "clients/cli/number.h"
#include "clients/cli/table.h"

static const char *const side_names[DIPOLE_MC_SIDES] = {"R", "T"};

static const char *const ends[] = {
    [DIPOLE_MC_PHOTONS] = "photons",
    [DIPOLE_MC_ERRORS] = "errors",
    [DIPOLE_MC_CANCELLED] = "cancelled",
    [DIPOLE_MC_STOPPED] = "stopped",
};

/* ---- energies: one list for all formats ---------------------------------------------------- */

/* A share of the power that entered. */
typedef struct share {
  const char *name;  /* for programs */
  const char *about; /* for people; parts of the one before are indented */
  dipole_mc_value value;
  bool on_other_side; /* only slabs have it */
} share;

enum { SHARES = 11 };

static void list_shares(const dipole_mc_energy *energy, share shares[SHARES]) {
  const dipole_mc_value R0 = {energy->unscattered[0], 0}, T0 = {energy->unscattered[1], 0};
  const share all[SHARES] = {
      {"R_total", "R, total", energy->R, false},
      {"R_unscattered", "  never scattered, at r = 0", R0, false},
      {"R_under", "  closer than the first ring", energy->under[0], false},
      {"R_over", "  beyond the last ring", energy->over[0], false},
      {"T_total", "T, total", energy->T, true},
      {"T_unscattered", "  never scattered, at r = 0", T0, true},
      {"T_under", "  closer than the first ring", energy->under[1], true},
      {"T_over", "  beyond the last ring", energy->over[1], true},
      {"absorbed", "absorbed", energy->absorbed, false},
      {"unfinished", "unfinished walks", energy->unfinished, false},
      {"roulette", "added by roulette", energy->roulette, false},
  };
  for (size_t i = 0; i < SHARES; i++) {
    shares[i] = all[i];
  }
}

/* ---- for people ---------------------------------------------------------------------------- */

static void write_title(const cli_mc_report *report, FILE *file) {
  const dipole_mc_query *query = &report->query;
  const dipole_mc_result *result = report->result;
  if (report->medium != NULL) {
    fprintf(file, "%s %s: ", report->medium, report->channel);
  }
  fprintf(file, "Monte Carlo, R in %s\n", report->info->R_unit);
  if (query->albedo_count > 0) {
    fprintf(file, "sigma_a + sigma_s %.6g 1/mm",
            query->medium.sigma_a_per_mm + query->medium.sigma_s_per_mm);
  } else {
    fprintf(file, "sigma_a %.6g 1/mm, sigma_s %.6g 1/mm", query->medium.sigma_a_per_mm,
            query->medium.sigma_s_per_mm);
  }
  fprintf(file, ", g %.6g, eta %.6g, ", query->medium.g, query->medium.eta);
  if (result->side_count == DIPOLE_MC_SIDES) {
    fprintf(file, "slab of %.6g mm\n", query->thickness_mm);
  } else {
    fputs("half space\n", file);
  }
  fprintf(file, "%llu photons, seed %llu", (unsigned long long)result->last.photons,
          (unsigned long long)query->seed);
  if (result->end == DIPOLE_MC_CANCELLED || result->end == DIPOLE_MC_STOPPED) {
    fprintf(file, "; CANCELLED: this is what had been walked by then");
  }
  fputc('\n', file);
}

/* Two header rows: names and units. */
static void add_ring_header(const dipole_mc_result *result, cli_table *table) {
  cli_table_add(table, "from");
  cli_table_add(table, "to");
  for (uint32_t side = 0; side < result->side_count; side++) {
    cli_table_add(table, "%s", side_names[side]);
    cli_table_add(table, "standard error");
    cli_table_add(table, "relative");
    cli_table_add(table, "photons");
  }
  cli_table_add(table, "mm");
  cli_table_add(table, "mm");
  for (uint32_t side = 0; side < result->side_count; side++) {
    cli_table_add(table, "1/mm^2");
    cli_table_add(table, "1/mm^2");
    cli_table_add(table, " ");
    cli_table_add(table, " ");
  }
}

/* A ring without light has an error, but none that is relative. */
static void add_ring(const dipole_mc_result *result, uint32_t albedo, uint32_t side, uint32_t ring,
                     cli_table *table) {
  const double value = dipole_mc_values(result, albedo, side)[ring];
  const double error = dipole_mc_errors(result, albedo, side)[ring];
  cli_table_add(table, "%.5e", value);
  cli_table_add(table, "%.1e", error);
  if (value > 0 && isfinite(error)) {
    cli_table_add(table, "%.2g %%", 100 * error / value);
  } else {
    cli_table_add(table, "-");
  }
  cli_table_add(table, "%llu", (unsigned long long)dipole_mc_photons(result, side)[ring]);
}

static void write_rings(const dipole_mc_result *result, uint32_t albedo, FILE *file) {
  cli_table table = {.heads = 2, .columns = 2 + 4 * (size_t)result->side_count};
  add_ring_header(result, &table);
  for (uint32_t ring = 0; ring < result->ring_count; ring++) {
    cli_table_add(&table, "%.6g", result->edges_mm[ring]);
    cli_table_add(&table, "%.6g", result->edges_mm[ring + 1]);
    for (uint32_t side = 0; side < result->side_count; side++) {
      add_ring(result, albedo, side, ring, &table);
    }
  }
  cli_table_print(&table, file);
}

static void write_shares(const dipole_mc_result *result, uint32_t albedo, FILE *file) {
  cli_table table = {.heads = 1, .columns = 3, .left = 1};
  share shares[SHARES];
  list_shares(&result->energies[albedo], shares);
  cli_table_add(&table, "per unit of power that entered");
  cli_table_add(&table, "share");
  cli_table_add(&table, "standard error");
  for (size_t i = 0; i < SHARES; i++) {
    if (shares[i].on_other_side && result->side_count < DIPOLE_MC_SIDES) {
      continue;
    }
    cli_table_add(&table, "%s", shares[i].about);
    cli_table_add(&table, "%.6g", shares[i].value.value);
    cli_table_add(&table, "%.1e", shares[i].value.error);
  }
  cli_table_print(&table, file);
}

void cli_mc_write_table(const cli_mc_report *report, FILE *file) {
  const dipole_mc_result *result = report->result;
  write_title(report, file);
  for (uint32_t albedo = 0; albedo < result->albedo_count; albedo++) {
    fprintf(file, "\nsingle-scattering albedo %.6g\n\n", result->energies[albedo].albedo);
    write_rings(result, albedo, file);
    fputc('\n', file);
    write_shares(result, albedo, file);
  }
}

/* ---- CSV ----------------------------------------------------------------------------------- */

static void write_csv_numbers(FILE *file, double albedo, const char *quantity, double from_mm,
                              double to_mm, dipole_mc_value value) {
  char text[CLI_NUMBER_BYTES];
  const double cells[] = {from_mm, to_mm, value.value, value.error};
  fprintf(file, "%s,%s", cli_number_format(albedo, text), quantity);
  for (size_t i = 0; i < sizeof cells / sizeof cells[0]; i++) {
    fprintf(file, ",%s", isnan(cells[i]) ? "" : cli_number_format(cells[i], text));
  }
}

static void write_csv_rings(const dipole_mc_result *result, uint32_t albedo, uint32_t side,
                            FILE *file) {
  const double *values = dipole_mc_values(result, albedo, side);
  const double *errors = dipole_mc_errors(result, albedo, side);
  for (uint32_t i = 0; i < result->ring_count; i++) {
    write_csv_numbers(file, result->energies[albedo].albedo, side_names[side], result->edges_mm[i],
                      result->edges_mm[i + 1], (dipole_mc_value){values[i], errors[i]});
    fprintf(file, ",%llu\n", (unsigned long long)dipole_mc_photons(result, side)[i]);
  }
}

/* One row for each ring (R, T) and for each share, which has no radii or photons. */
void cli_mc_write_csv(const cli_mc_report *report, FILE *file) {
  const dipole_mc_result *result = report->result;
  share shares[SHARES];
  fputs("albedo,quantity,from,to,value,error,photons\n", file);
  for (uint32_t albedo = 0; albedo < result->albedo_count; albedo++) {
    const dipole_mc_energy *energy = &result->energies[albedo];
    for (uint32_t side = 0; side < result->side_count; side++) {
      write_csv_rings(result, albedo, side, file);
    }
    list_shares(energy, shares);
    for (size_t i = 0; i < SHARES; i++) {
      if (!shares[i].on_other_side || result->side_count == DIPOLE_MC_SIDES) {
        write_csv_numbers(file, energy->albedo, shares[i].name, (double)NAN, (double)NAN,
                          shares[i].value);
        fputs(",\n", file);
      }
    }
  }
}

/* ---- JSON ---------------------------------------------------------------------------------- */

static void write_json_query(cli_json *json, const dipole_mc_query *query) {
  cli_json_number(json, "sigma_a", query->medium.sigma_a_per_mm);
  cli_json_number(json, "sigma_s", query->medium.sigma_s_per_mm);
  cli_json_number(json, "g", query->medium.g);
  cli_json_number(json, "eta", query->medium.eta);
  cli_json_number(json, "thickness", query->thickness_mm);
  cli_json_count(json, "seed", query->seed);
}

static void write_json_units(cli_json *json, const cli_mc_report *report) {
  cli_json_begin(json, "units", '{');
  cli_json_text(json, "sigma_a", "1/mm");
  cli_json_text(json, "sigma_s", "1/mm");
  cli_json_text(json, "thickness", "mm");
  cli_json_text(json, "edges", "mm");
  cli_json_text(json, "R", report->info->R_unit);
  cli_json_text(json, "T", report->info->R_unit);
  cli_json_text(json, "shares", "per unit of power that entered");
  cli_json_end(json, '}');
}

static void write_json_shares(cli_json *json, const dipole_mc_energy *energy) {
  share shares[SHARES];
  list_shares(energy, shares);
  cli_json_begin(json, "shares", '{');
  for (size_t i = 0; i < SHARES; i++) {
    cli_json_begin(json, shares[i].name, '{');
    cli_json_number(json, "value", shares[i].value.value);
    cli_json_number(json, "error", shares[i].value.error);
    cli_json_end(json, '}');
  }
  cli_json_end(json, '}');
}

static void write_json_albedo(cli_json *json, const dipole_mc_result *result, uint32_t albedo) {
  static const char *const errors[DIPOLE_MC_SIDES] = {"R_error", "T_error"};
  cli_json_begin(json, NULL, '{');
  cli_json_number(json, "albedo", result->energies[albedo].albedo);
  for (uint32_t side = 0; side < result->side_count; side++) {
    cli_json_numbers(json, side_names[side], dipole_mc_values(result, albedo, side),
                     result->ring_count);
    cli_json_numbers(json, errors[side], dipole_mc_errors(result, albedo, side),
                     result->ring_count);
  }
  write_json_shares(json, &result->energies[albedo]);
  cli_json_end(json, '}');
}

static void write_json_photons(cli_json *json, const dipole_mc_result *result) {
  static const char *const names[DIPOLE_MC_SIDES] = {"R_photons", "T_photons"};
  for (uint32_t side = 0; side < result->side_count; side++) {
    cli_json_begin(json, names[side], '[');
    for (uint32_t i = 0; i < result->ring_count; i++) {
      cli_json_count(json, NULL, dipole_mc_photons(result, side)[i]);
    }
    cli_json_end(json, ']');
  }
}

void cli_mc_write_json(const cli_mc_report *report, FILE *file) {
  const dipole_mc_result *result = report->result;
  cli_json json = {.file = file};
  cli_json_begin(&json, NULL, '{');
  cli_json_text(&json, "software", report->info->software);
  if (report->medium != NULL) {
    cli_json_text(&json, "medium", report->medium);
    cli_json_text(&json, "channel", report->channel);
  }
  write_json_query(&json, &report->query);
  write_json_units(&json, report);
  cli_json_text(&json, "ended_by", ends[result->end]);
  cli_json_count(&json, "photons", result->last.photons);
  cli_json_number(&json, "error_total", result->last.error_total);
  cli_json_number(&json, "error_rings", result->last.error_rings);
  cli_json_numbers(&json, "edges", result->edges_mm, (size_t)result->ring_count + 1);
  write_json_photons(&json, result);
  cli_json_begin(&json, "albedos", '[');
  for (uint32_t albedo = 0; albedo < result->albedo_count; albedo++) {
    write_json_albedo(&json, result, albedo);
  }
  cli_json_end(&json, ']');
  cli_json_end(&json, '}');
}
