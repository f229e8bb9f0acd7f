/* What the vectors lead to. */
#ifndef INTERRUPTS_H
#define INTERRUPTS_H

void on_reset(void);
void on_tick(void);   /* SysTick */
void on_can(void);    /* FDCAN1 */
void on_toggle(void); /* TIM2 */
void on_wake(void);   /* TIM5 */
void on_scan(void);   /* DMA2, channel 1 */
int main(void);

#endif
