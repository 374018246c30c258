/* transport: what the solver and the table of radiative transport share. */
#ifndef DIPOLED_CORE_TRANSPORT_TRANSPORT_H
#define DIPOLED_CORE_TRANSPORT_TRANSPORT_H

/* The range of the index inside over the index outside. */
#define TRANSPORT_ETA_MIN 0.25
#define TRANSPORT_ETA_MAX 4.0

/* A number and the estimate of its absolute error. */
typedef struct transport_number {
  double value;
  double error;
} transport_number;

#endif
