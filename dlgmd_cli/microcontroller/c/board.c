/* Start-up code, vectors and a clock to run test.c on Arm's MPS2 boards under QEMU. The C library's
   semihosting reads frames.gray and prints. */
#ifndef ARDUINO /* which compiles every file of a library */
#include <stdint.h>
#include <stdio.h>
#include <unistd.h>

extern uint32_t board_stack_top[], board_bss_start[], board_bss_end[];
int main(void);
void initialise_monitor_handles(void);
uint32_t board_ticks(void);
void board_reset(void);

static volatile uint32_t *const systick = (volatile uint32_t *)0xe000e010;

/* SysTick counts down at 25 MHz, in 24 bits. */
uint32_t board_ticks(void)
{
    return systick[2];
}

void board_reset(void)
{
#ifdef __ARM_FP
    *(volatile uint32_t *)0xe000ed88 |= 0xfu << 20; /* CPACR: switch the FPU on */
    __asm volatile("dsb\n\tisb");
#endif
    for (uint32_t *word = board_bss_start; word < board_bss_end; word++) {
        *word = 0;
    }
    systick[1] = 0xffffff;
    systick[0] = 5; /* on, by the processor's clock */
    initialise_monitor_handles();
    int code = main();
    fflush(stdout);
    _exit(code);
}

static void board_fault(void)
{
    _exit(3);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    board_stack_top, (void *)board_reset, (void *)board_fault, (void *)board_fault,
    (void *)board_fault, (void *)board_fault, (void *)board_fault};
#endif
