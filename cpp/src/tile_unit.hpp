// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The processor's unit for products of tiles of bfloat16 (Intel's AMX), which a process has to ask the system for.
#pragma once

namespace followthrough {

/// @return whether there are kernels for it, the processor has it and the system lets this process use it
bool has_tile_unit() noexcept;

/// @throws InvalidInput about the `precision` that needs it, where has_tile_unit does not hold
void require_tile_unit();

}  // namespace followthrough
