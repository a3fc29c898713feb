/*
 * $title
 *
 * Translated by "mfpcc firmware" from the controller's kernels; see README.md.
 *
 * One object holds all there is of a drive. There is no heap, no global state, no call into an
 * operating system; of the C library only <math.h> is used. A step takes the same way whatever
 * the clock says, and may be called from one interrupt.
 *
 * Complex numbers are space vectors, amplitude-invariant: dq in the rotor frame, ab in the
 * stationary frame. k is the sample at hand; the command computed from it applies in period k + 1.
 */
#ifndef MFPCC_H
#define MFPCC_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Every real number of the controller. */
typedef $real mfpcc_real;

typedef struct {
    mfpcc_real re;
    mfpcc_real im;
} mfpcc_complex;

$structs

/* A drive: give it to mfpcc_init() first. */
typedef struct {
    mfpcc_cfg cfg;
    mfpcc_memory memory;
} mfpcc_controller;

/* Schemes, as the field "scheme" of the configuration knows them. */
$scheme_numbers

/* Faults, as the bits of memory.guard.latch.faults. */
$fault_numbers

/* What can be set while the drive runs; the names are those of the fields of mfpcc_cfg. */
typedef enum {
$parameter_names
    MFPCC_PARAMETERS
} mfpcc_parameter;

typedef enum {
    MFPCC_OK,
    MFPCC_UNKNOWN_PARAMETER,
    MFPCC_BAD_VALUE /* no finite number, or none that the parameter may have */
} mfpcc_result;

/* Put a drive into its first state, with the parameters of parameters.h and the gates to be on. */
void mfpcc_init(mfpcc_controller *self);

/*
 * One PWM period: from the sample of period k to the command for period k + 1.
 *
 * sample, command, diagnostics: none may be a part of another. diagnostics may be NULL. A sample
 * that is not newer than the one before is counted as invalid; the command then stays as it is.
 */
void mfpcc_step(mfpcc_controller *self, const mfpcc_sample *sample, mfpcc_command *command,
    mfpcc_diagnostics *diagnostics);

/* Set a parameter; it acts from the next sample on. Nothing changes unless the result is OK. */
mfpcc_result mfpcc_set_parameter(mfpcc_controller *self, mfpcc_parameter parameter,
    mfpcc_real value);

/* Safe torque off: the gates go off with the next command, until mfpcc_clear_faults(). */
void mfpcc_stop(mfpcc_controller *self);

/*
 * Forget the latched faults. Returns those whose cause lasts, bit by bit, and then clears none.
 * The gates go on again once the reference has been at zero.
 */
uint32_t mfpcc_clear_faults(mfpcc_controller *self);

#ifdef __cplusplus
}
#endif

#endif
