"""What several items measure on. Modules here may import what they like: they hold no items."""
