#include "machine/simulated_machine.h"
