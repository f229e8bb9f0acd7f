/* The registers of an STM32G474 that this firmware uses, named as RM0440 names them. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

#define AT(type, address) ((type *)(address))

typedef volatile uint32_t reg;

struct gpio { reg MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFR[2]; };
struct tim { reg CR1, CR2, SMCR, DIER, SR, EGR, CCMR[2], CCER, CNT, PSC, ARR, RCR, CCR[4]; };
struct dma { reg ISR, IFCR; struct { reg CCR, CNDTR, CPAR, CMAR, reserved; } CH[8]; };
struct adc { reg ISR, IER, CR, CFGR, CFGR2, SMPR[2], reserved[5], SQR[4], DR; };
struct iwdg { reg KR, PR, RLR, SR, WINR; };
struct rcc {
    reg CR, ICSCR, CFGR, PLLCFGR, reserved0[14], AHB1ENR, AHB2ENR, AHB3ENR, reserved1, APB1ENR1,
        APB1ENR2, APB2ENR, reserved2[9], CCIPR, reserved3[2], CSR;
};
struct fdcan {
    reg CREL, ENDN, reserved0, DBTP, TEST, RWD, CCCR, NBTP, reserved1[8], ECR, PSR, TDCR, reserved2,
        IR, IE, ILS, ILE, reserved3[8], RXGFC, XIDAM, HPMS, reserved4, RXF0S, RXF0A, RXF1S, RXF1A,
        reserved5[8], TXBC, TXFQS, TXBRP, TXBAR, TXBCR, TXBTO, TXBCF, TXBTIE;
};
struct can_element { reg id, dlc, data[16]; };
struct can_ram {
    reg standard_filters[28], extended_filters[16];
    struct can_element rx0[3], rx1[3];
    reg tx_events[6];
    struct can_element tx[3];
};

#define TIM2 AT(struct tim, 0x40000000)
#define TIM3 AT(struct tim, 0x40000400)
#define TIM5 AT(struct tim, 0x40000C00)
#define TIM6 AT(struct tim, 0x40001000)
#define IWDG AT(struct iwdg, 0x40003000)
#define FDCAN1 AT(struct fdcan, 0x40006400)
#define FDCAN1_RAM AT(struct can_ram, 0x4000A400)
#define DMA1 AT(struct dma, 0x40020000)
#define DMA2 AT(struct dma, 0x40020400)
#define DMAMUX AT(reg, 0x40020800) /* channels 0 to 7 are those of DMA1, 8 to 15 of DMA2 */
#define RCC AT(struct rcc, 0x40021000)
#define FLASH_ACR AT(reg, 0x40022000)
#define GPIOA AT(struct gpio, 0x48000000)
#define GPIOB AT(struct gpio, 0x48000400)
#define GPIOC AT(struct gpio, 0x48000800)
#define ADC1 AT(struct adc, 0x50000000)
#define ADC2 AT(struct adc, 0x50000100)
#define ADC12_CCR AT(reg, 0x50000308)
#define SYSTICK AT(reg, 0xE000E010U) /* CSR, RVR, CVR */
#define NVIC_ISER AT(reg, 0xE000E100U)

#define BIT(n) (UINT32_C(1) << (n))
#define FIELD(value, at) ((uint32_t)(value) << (at)) /* `at`: its lowest bit */

#endif
