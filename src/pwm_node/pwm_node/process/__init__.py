"""The process around a loop at PWM rate: its memory, its cores, what the middleware leaves."""
