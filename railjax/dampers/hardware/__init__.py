"""From a drawing to a damper: hydraulics, magnetic circuit, the device, and its design.

Imports base, model and the laws of dampers."""
