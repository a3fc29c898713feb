/*
 * The test vectors on a Cortex-M: how many commands are equal, and the time that the steps took.
 *
 * Text goes out by semihosting (QEMU, or a debugger). SysTick counts the processor's clock.
 */
#include "mfpcc.h"
#include "vectors.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))

extern uint32_t stack_top;
int main(void);
void reset(void);

/* As the compiler asks for them, where no C library starts the program. */
int errno_of_libm;
int *__errno(void);
int *__errno(void)
{
    return &errno_of_libm;
}

__attribute__((section(".vectors"), used)) static const uintptr_t VECTORS[16] = {
    (uintptr_t)&stack_top, (uintptr_t)reset, (uintptr_t)reset, (uintptr_t)reset};

void reset(void)
{
    REGISTER(0xE000ED88U) |= 0xFU << 20; /* the floating-point unit on */
    __asm volatile("dsb; isb");
    (void)main();
    for (;;) {
    }
}

static void host(uint32_t operation, const void *argument)
{
    register uint32_t r0 __asm("r0") = operation;
    register const void *r1 __asm("r1") = argument;
    __asm volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static void say(uint32_t number)
{
    char text[12];
    int at = 11;
    text[at] = '\0';
    do {
        text[--at] = (char)('0' + number % 10U);
        number /= 10U;
    } while (number != 0U);
    host(0x04, &text[at]);
    host(0x04, "\n");
}

static mfpcc_controller drive;
static mfpcc_command command[SAMPLES];

int main(void)
{
    static const uint32_t REASON[2] = {0x20026U, 0U};
    mfpcc_init(&drive);
$references
    REGISTER(0xE000E014U) = 0xFFFFFFU;
    REGISTER(0xE000E018U) = 0U;
    REGISTER(0xE000E010U) = 5U; /* the processor's clock, no interrupt */
    const uint32_t begin = REGISTER(0xE000E018U);
    for (int n = 0; n < SAMPLES; ++n) {
        mfpcc_step(&drive, &SAMPLE[n], &command[n], (mfpcc_diagnostics *)0);
    }
    const uint32_t end = REGISTER(0xE000E018U);
    uint32_t equal = 0U;
    for (int n = 0; n < SAMPLES; ++n) {
        const expected_command *e = &EXPECTED[n];
        const mfpcc_command *c = &command[n];
        equal += (c->duty[0] == e->duty[0] && c->duty[1] == e->duty[1] && c->duty[2] == e->duty[2]
                     && c->vectors[0] == e->vectors[0] && c->vectors[1] == e->vectors[1]
                     && c->enable == e->enable)
            ? 1U
            : 0U;
    }
    say(equal);
    say((begin - end) & 0xFFFFFFU);
    host(0x18, (const void *)(uintptr_t)REASON[0]);
    return 0;
}
