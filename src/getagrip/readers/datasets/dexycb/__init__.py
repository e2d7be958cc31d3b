"""DexYCB."""
