/* Reads grey frames from standard input, one byte per cell, and prints one line of CSV per frame:
   ffmpeg -i flight.mp4 -vf scale=WIDTH:HEIGHT:flags=area -f rawvideo -pix_fmt gray - | ./dlgmd
   Arguments are the steps from frame to frame in microseconds, again and again: ./dlgmd 16667 for 60
   frames a second. Without any, they are 1/30 s. */
#ifndef ARDUINO /* which compiles every file of a library */
#include "dlgmd.h"

#include <stdio.h>
#include <stdlib.h>

static const char *const rules[] = {"spikes", "ttc", "expansion"};
static const char *const reasons[] = {"", "black", "flat", "noise", "frozen", "unmeasured"};
static dlgmd_state state;
static dlgmd_sight sight;
static uint8_t frame[DLGMD_HEIGHT * DLGMD_WIDTH];

/* A field, empty where it is not known. */
static void print_if(bool is_known, double value)
{
    if (is_known) {
        printf("%.9g", value);
    }
    putchar(',');
}

int main(int n_arguments, char **arguments)
{
    unsigned long number = 0;
    size_t n_read;
    dlgmd_reset(&state);
    dlgmd_health_reset(&sight);
    puts("frame,mp,mp_abs,spike,alarm,rule,g_x,g_y,expansion,expansion_upright,expansion_quality,"
         "ttc_s,expansion_x,expansion_y,blind");
    while ((n_read = fread(frame, 1, sizeof frame, stdin)) == sizeof frame) {
        unsigned long n_steps = (unsigned long)n_arguments - 1;
        uint32_t step_us = n_steps ? (uint32_t)atoi(arguments[1 + number % n_steps]) : 0;
        dlgmd_answer answer = dlgmd_step_us(&state, frame, step_us);
        dlgmd_blind health = dlgmd_health_us(&sight, frame, step_us);
        printf("%lu,", number);
        print_if(answer.valid, (double)answer.mp);
        print_if(answer.valid, (double)answer.mp_abs);
        printf("%d,%d,%s,", answer.spike, answer.alarm, rules[answer.rule]);
        print_if(answer.mp > 0, (double)answer.g_x);
        print_if(answer.mp > 0, (double)answer.g_y);
#if DLGMD_EXPANSION
        bool is_measured = number > 0;
#else
        bool is_measured = false;
#endif
        print_if(answer.expansion_quality > 0, (double)answer.expansion);
        print_if(answer.expansion_quality > 0, (double)answer.expansion_upright);
        print_if(is_measured, (double)answer.expansion_quality);
        print_if(answer.has_ttc, (double)answer.ttc_s);
        print_if(is_measured, (double)answer.expansion_x);
        print_if(is_measured, (double)answer.expansion_y);
        puts(reasons[dlgmd_blind_of(health, &answer)]);
        number++;
    }
    if (n_read > 0 || number == 0) {
        fprintf(stderr, "The input does not end with a whole frame of %d x %d bytes.\n", DLGMD_WIDTH,
                DLGMD_HEIGHT);
        return 1;
    }
    return 0;
}
#endif
