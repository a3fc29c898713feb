/*
 * $title
 *
 * Translated by "mfpcc firmware"; each function is a kernel of the Python module named above it.
 * To change it, change the kernel, and translate again.
 */
#include "mfpcc.h"

#include <math.h>
#include <stddef.h>

#include "parameters.h"

$program
/* --- The interface */

void mfpcc_init(mfpcc_controller *self)
{
    const mfpcc_memory nothing = {0};
    self->cfg = PARAMETERS;
    self->memory = nothing;
$first_memory
}

void mfpcc_step(mfpcc_controller *self, const mfpcc_sample *sample, mfpcc_command *command,
    mfpcc_diagnostics *diagnostics)
{
    controller_answer(&self->cfg, &self->memory, sample, command, diagnostics,
        diagnostics != NULL);
}

mfpcc_result mfpcc_set_parameter(mfpcc_controller *self, mfpcc_parameter parameter,
    mfpcc_real value)
{
    mfpcc_cfg *cfg = &self->cfg;
    if (!isfinite(value)) {
        return MFPCC_BAD_VALUE;
    }
    switch (parameter) {
$cases
    case MFPCC_PARAMETERS:
    default:
        return MFPCC_UNKNOWN_PARAMETER;
    }
    return MFPCC_OK;
}

void mfpcc_stop(mfpcc_controller *self)
{
    self->memory.guard.slowing = false;
    self->memory.guard.latch.tripped = true;
}

uint32_t mfpcc_clear_faults(mfpcc_controller *self)
{
    mfpcc_memory *mem = &self->memory;
    const uint32_t lasting = mem->guard.latch.present & mem->guard.latch.faults;
    if (lasting == 0U) {
        mem->guard.latch.tripped = false;
        mem->guard.latch.faults = 0U;
        mem->guard.awaits_zero = true;
        mem->guard.slowing = false;
        mem->fallen = false;
        mem->failed = false;
    }
    return lasting;
}
