/* table: panels as CSV files. A value that is not known is an empty field; numbers are written so
 * that they read back as the same bits. */
#ifndef FIGURES_TABLE_H
#define FIGURES_TABLE_H

#include <stdio.h>

#include "core/tools/figures/panel.h"
#include "core/tools/tools.h"

/* A comma and the number, or a comma alone for NaN. */
void table_put(FILE *file, double number);

/* The columns of one source of one panel: a row for each ring. */
void table_keep(const char *path, const panel_data *panel, enum panel_source source);

/* Reads what table_keep() wrote; false, with the panel as it was, when there is no such file or it
 * holds anything else. */
bool table_recall(const char *path, panel_data *panel, enum panel_source source);

/* All columns of panels that are wanted: figure, ratio, eta, r and a row for each ring; and
 * the albedos, a row for each panel and curve. figure: its number. */
void table_write_figure(const char *path, size_t figure, const panel_data *const *panels,
                        size_t count);
void table_write_albedos(const char *path, size_t figure, const panel_data *const *panels,
                         size_t count);

#endif
